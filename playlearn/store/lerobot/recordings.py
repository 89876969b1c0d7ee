"""A LeRobot dataset as something to import, for who would rather have it in a store of ours than train on it so."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from playlearn.episode import Episode
from playlearn.errors import EpisodeError, StoreError
from playlearn.store.base import Store, StoreSpec


class LeRobotRecordings:
    """See `importing.Recordings`. What is broken was told when the store was opened."""

    splits: Mapping[str, Sequence[int]] = {}

    def __init__(self, store: Store) -> None:
        self._store = store
        self._places = {int(number): i for i, number in enumerate(store.indices())}
        self.spec: StoreSpec = store.spec
        self.note: Mapping[str, Any] = {"format": "lerobot", "source": store.name()}

    def names(self) -> dict[int, str]:
        return {number: f"episode {number}" for number in self._places}

    def problems(self) -> dict[int, str]:
        return {}

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        for number in numbers:
            try:
                yield number, self._store.read(self._places[number])
            except (StoreError, EpisodeError) as error:
                yield number, StoreError(f"episode {number}: {error}")
