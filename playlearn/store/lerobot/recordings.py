"""A LeRobot dataset as something to import, for who would rather have it in a store of ours than train on it so."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from playlearn.episode import Episode
from playlearn.errors import EpisodeError, StoreError
from playlearn.store.base import StoreSpec
from playlearn.store.lerobot.config import LeRobotStoreConfig
from playlearn.store.lerobot.reader import LeRobotStore


class LeRobotRecordings:
    """See `importing.Recordings`; raises StoreError where nothing of the dataset can be read."""

    def __init__(self, config: LeRobotStoreConfig) -> None:
        self._store = LeRobotStore(replace(config, skip_broken=True))
        self._places = {int(number): i for i, number in enumerate(self._store.indices())}
        self.spec: StoreSpec = self._store.spec
        self.note: Mapping[str, Any] = {"format": "lerobot", "source": self._store.name()}
        self.splits: Mapping[str, Sequence[int]] = {}

    def names(self) -> dict[int, str]:
        return {number: f"episode {number}" for number in [*self._places, *self.problems()]}

    def problems(self) -> dict[int, str]:
        return {self._number(entry): one.words for one in self._store.problems for entry in sorted(one.episodes)}

    def _number(self, entry: int) -> int:
        try:
            return self._store.number(entry)
        except (StoreError, KeyError):  # what says it is what is broken
            return -1 - entry

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        for number in numbers:
            try:
                yield number, self._store.read(self._places[number])
            except (StoreError, EpisodeError) as error:
                yield number, StoreError(f"episode {number}: {error}")
