"""One demonstration of robomimic's, as its group holds it.

    obs        o_0 --a_0--> o_1 --a_1--> o_2 ... o_{T-1} --a_{T-1}-->
    next_obs                o_1          o_2 ... o_{T-1}              o_T

`next_obs` may be missing. Then an episode has the actions before `o_{T-1}`, and the last one is its `unobserved_step`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from playlearn.episode import Array
from playlearn.store.hdf5 import LAST, dataset, numbers_problem
from playlearn.store.success import Signals

_NO_LAST_STATE = {"states": "left out: the one after the last action is missing (`next_states`)"}
_DONES = {"dones": "left out where they mark more or less than a demonstration's end; `export robomimic` marks the end"}


@dataclass(frozen=True, eq=False)
class RobomimicDemonstration:
    """Reads its arrays; the file stays open meanwhile.

    group: `data/demo_...`.
    observed: the keys of `obs` that are read.
    """

    group: Any
    observed: Sequence[str]

    @cached_property
    def whole(self) -> bool:
        """Whether what was observed after the last action is there."""
        import h5py

        if not isinstance(self.group.get("next_obs", getlink=True), h5py.HardLink):
            return False
        after = self.group["next_obs"]
        return isinstance(after, h5py.Group) and all(key in after for key in self.observed)

    @property
    def steps(self) -> int:
        """T, the actions after which something was observed."""
        rows = int(dataset(self.group, "actions").shape[0])
        return rows if self.whole else rows - 1

    def problem(self, layout: Mapping[str, Sequence[int]]) -> str | None:
        """Why it cannot be read, judging by shapes; None if it can. Raises StoreError where an array is missing.

        layout: the shape of a row of `actions` and of each `obs/...` that is read.
        """
        found = {key: dataset(self.group, key) for key in layout}
        rows = found["actions"].shape[0] if found["actions"].ndim == 2 else 0
        needed = 1 if self.whole else 2
        if rows < needed:
            return f"it has {rows} actions (of shape {found['actions'].shape}), and an episode needs {needed} or more"
        shapes = {key: (rows, *row) for key, row in layout.items()}
        if self.whole:
            found |= {f"next_obs/{key}": dataset(self.group, f"next_obs/{key}") for key in self.observed}
            shapes |= {f"next_obs/{key}": shapes[f"obs/{key}"] for key in self.observed}
        for key in ("rewards", "dones"):
            if key in self.group:
                found[key] = one = dataset(self.group, key)
                shapes[key] = (rows, 1) if one.ndim == 2 else (rows,)
        for key in ("states", "next_states"):
            if key in self.group and "states" in self.group:
                found[key] = dataset(self.group, key)
                shapes[key] = (rows, *dataset(self.group, "states").shape[1:2])
        problems = {key: numbers_problem(one, shapes[key]) for key, one in found.items()}
        return next((f"{key} {problem}" for key, problem in problems.items() if problem), None)

    def moments(self, key: str) -> Array:
        """(T+1, ...) what it holds of each moment under `obs/...` or `states`."""
        rows = np.asarray(dataset(self.group, key)[()])
        return np.concatenate([rows, dataset(self.group, f"next_{key}")[-1:]]) if self.whole else rows

    def vectors(self, keys: Sequence[str]) -> Array:
        """(T+1, n) float32, these keys of `obs` side by side."""
        rows = self.steps + 1
        columns = [self.moments(f"obs/{key}").astype(np.float32).reshape(rows, -1) for key in keys]
        return np.concatenate([np.zeros((rows, 0), np.float32), *columns], axis=1)

    @property
    def _has_states(self) -> bool:
        return "states" in self.group and ("next_states" in self.group or not self.whole)

    def states(self) -> Array:
        """(T+1, N) float64 the simulator's; N = 0 where the last one is missing."""
        rows = self.steps + 1
        return self.moments("states").astype(np.float64).reshape(rows, -1) if self._has_states else np.zeros((rows, 0))

    def actions(self) -> Array:
        """(T, A) float32."""
        return np.asarray(dataset(self.group, "actions")[: self.steps], np.float32)

    def rewards(self) -> Array | None:
        """(T,) as recorded."""
        recorded = self.signals.rewards
        return None if recorded is None else recorded[: self.steps]

    def unobserved_step(self) -> dict[str, Any]:
        """See `EpisodeMeta`."""
        if self.whole:
            return {}
        step: dict[str, Any] = {"action": np.asarray(dataset(self.group, "actions")[-1], np.float32).tolist()}
        rewards = self.signals.rewards
        return step if rewards is None else {**step, "reward": float(rewards[-1])}

    @cached_property
    def signals(self) -> Signals:
        """All that it says of its outcome."""
        rewards, dones = (
            np.asarray(dataset(self.group, key), np.float64).reshape(-1) if key in self.group else None
            for key in ("rewards", "dones")
        )
        return Signals(rewards, dones)

    def remarks(self) -> dict[str, str]:
        """What is known of it and has no place in an episode -> why it is left out."""
        lost = "states" in self.group and not self._has_states
        dones = self.signals.dones
        odd = dones is not None and (not dones[-1] or bool(dones[:-1].any()))
        return ({} if self.whole else LAST) | (_NO_LAST_STATE if lost else {}) | (_DONES if odd else {})
