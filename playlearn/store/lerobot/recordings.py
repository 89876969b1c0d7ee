"""A LeRobot dataset as recordings to import, for those who prefer a native store to training on it directly."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from playlearn.episode import Episode
from playlearn.errors import EpisodeError, StoreError
from playlearn.store.base import StoreSpec
from playlearn.store.lerobot.reader import LeRobotStore


class LeRobotRecordings:
    """See `importing.Recordings`."""

    def __init__(self, store: LeRobotStore, settings: Mapping[str, Any] = MappingProxyType({})) -> None:
        """store: opened with `skip_broken`; the episodes that it left out are reported by `problems`.

        settings: how it was opened, as JSON.
        """
        self._store = store
        self._places = {int(number): i for i, number in enumerate(self._store.indices())}
        self.spec: StoreSpec = self._store.spec
        self.note: Mapping[str, Any] = {"format": "lerobot", "source": self._store.name(), **settings}
        self.splits: Mapping[str, Sequence[int]] = {}
        self.remarks: Mapping[str, str] = self._store.remarks()

    def names(self) -> dict[int, str]:
        return {number: f"episode {number}" for number in [*self._places, *self.problems()]}

    def problems(self) -> dict[int, str]:
        return {self._number(entry): one.message for one in self._store.problems for entry in sorted(one.episodes)}

    def _number(self, entry: int) -> int:
        try:
            return self._store.number(entry)
        except (StoreError, KeyError):  # the sidecar that holds the number is the one that is broken
            return -1 - entry

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        for number in numbers:
            try:
                yield number, self._store.read(self._places[number])
            except (StoreError, EpisodeError) as error:
                yield number, StoreError(f"episode {number}: {error}")
