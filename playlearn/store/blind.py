"""A store as a robot would have recorded it: what only a simulator or a scripted teleoperator knows is hidden.

    hidden                          what stands there instead
    achieved, its names             no dimensions
    sim.state, seed                 no dimensions, -1
    expert_action                   what was executed
    skill, meta.skills              0, none
    reward, meta.success, ended     none, unknown
    environment                     its type and robot alone

Nothing of what is hidden is read, so no training on such a store can depend on it.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import IMAGES, REWARD, STORED, Array, Episode, EpisodeMeta
from playlearn.store.base import Store, StoreSpec, summary

NO_SEED = -1
NAMING = ("type", "robot")  # of an environment: from these no scene can be built again
EXECUTED = STORED["action"]


class BlindStore:
    """The read side of another store without what is hidden; safe to share between threads where that is."""

    def __init__(self, store: Store) -> None:
        """store: what is hidden of it stays unread."""
        self._store, spec = store, store.spec
        quantities = dataclasses.replace(spec.quantities, achieved=())
        self.spec: StoreSpec = dataclasses.replace(
            spec, environment=_named(spec.environment), achieved_names=(), quantities=quantities
        )
        self._lengths = store.lengths()

    def __len__(self) -> int:
        return len(self._store)

    def name(self) -> str:
        return self._store.name()

    def indices(self) -> NDArray[np.int64]:
        return self._store.indices()

    def lengths(self) -> NDArray[np.int64]:
        return self._lengths

    def cameras(self) -> dict[str, tuple[int, int]]:
        return self._store.cameras()

    def meta(self, i: int) -> EpisodeMeta:
        meta = self._store.meta(i)
        return dataclasses.replace(
            meta,
            environment=_named(meta.environment),
            achieved_names=(),
            seed=NO_SEED,
            skills=(),
            ended="unknown",
            success=None,
            quantities=dataclasses.replace(meta.quantities, achieved=()),
        )

    def read(self, i: int) -> Episode:
        keys = [*STORED.values(), *(IMAGES + camera for camera in self.cameras())]
        return Episode.from_arrays(self.meta(i), {key: self.array(i, key) for key in keys})

    def array(self, i: int, key: str) -> Array:
        if key == STORED["expert_action"]:
            return self._store.array(i, EXECUTED)
        steps = len(self._store.array(i, EXECUTED))
        hidden: dict[str, Array] = {
            STORED["achieved"]: np.zeros((steps + 1, 0), np.float32),
            STORED["sim_state"]: np.zeros((steps + 1, 0)),
            STORED["skill"]: np.zeros(steps, np.int16),
        }
        if key in hidden:
            hidden[key].flags.writeable = False
            return hidden[key]
        return self._store.array(i, key)

    def digests(self) -> dict[str, str]:
        return self._store.digests()

    def remarks(self) -> Mapping[str, str]:
        hidden = self._hidden()
        return {**self._store.remarks(), **({", ".join(hidden): "hidden: `blind`"} if hidden else {})}

    def rewards(self, i: int) -> Array | None:
        return None

    def verify(self) -> list[str]:
        return self._store.verify()

    def info(self) -> dict[str, Any]:
        return {**self._store.info(), **summary(self)}

    def _hidden(self) -> list[str]:
        """What the first episode has of all that is hidden."""
        if not len(self):
            return []
        store, there = self._store, []
        there += [STORED["achieved"]] if store.spec.achieved_names else []
        there += [STORED["sim_state"]] if store.array(0, STORED["sim_state"]).shape[1] else []
        label = store.array(0, STORED["expert_action"])
        there += [] if np.array_equal(label, store.array(0, EXECUTED)) else [STORED["expert_action"]]
        there += [STORED["skill"]] if store.meta(0).skills else []
        there += [] if store.rewards(0) is None else [REWARD]
        return there + ([] if store.meta(0).success is None else ["success"])


def _named(environment: Mapping[str, Any]) -> dict[str, Any]:
    return {name: environment[name] for name in NAMING if name in environment}
