"""robosuite's PickPlace with one object: out of a bin, into one of four compartments, and back.

`achieved` (6,) for the can, (8,) for the boxes; meters unless noted:

    x y z              its center
    up                 how upright its long axis is: 1 standing .. 0 lying
    long.c long.s      the long axis a in the plane as (ax^2 - ay^2, 2 ax ay): 0 while it stands
    thin.c thin.s      the same of its thinnest axis; a can has none
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from playlearn.envs.parcel import FLOOR, PALM, RIM, Parcel, ParcelSkillLibrary
from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View, upright
from playlearn.episode import Array
from playlearn.oracles import register_skill_library
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, Task

PARCELS = {
    "milk": Parcel("milk", (0.020, 0.020), below=0.061, above=0.072, thin=0),  # and a roof, too narrow to grip
    "bread": Parcel("bread", (0.020, 0.024), below=0.023, above=0.025, thin=1),
    "cereal": Parcel("cereal", (0.015, 0.050), below=0.075, above=0.075, thin=1),
    "can": Parcel("can", (0.025, 0.025), below=0.040, above=0.040),
}
"""In the order in which robosuite gives each its compartment."""
BIN = ((-0.01, 0.21), (-0.40, -0.10))  # x and y where objects are laid in the first bin
LEFT_BIN = ((-0.1, 0.3), (-0.5, 0.0))  # x and y of all of it
POSITION_TOLERANCE, HEIGHT_TOLERANCE, UP_TOLERANCE = 0.04, 0.02, 0.3
LIFTED = 0.04  # meters above where it rests
_CENTERS = ((0.0025, 0.1575), (0.1975, 0.1575), (0.0025, 0.4025), (0.1975, 0.4025))  # of the compartments
_LAID = ((0.01, 0.16), (0.165, 0.16), (0.01, 0.38), (0.175, 0.375))  # where in them an arm can lay something
_HALF = (0.0975, 0.1225)


@EnvironmentConfig.register_subclass("pick_place")
@dataclass(frozen=True)
class PickPlaceConfig(TabletopConfig):
    """robosuite's PickPlace with one object.

    object: which of robosuite's four.
    beyond: fraction of random starts with it in a compartment; all others are robosuite's own: standing anywhere in
        the first bin.
    """

    object: Literal["can", "milk", "bread", "cereal"] = "can"
    beyond: float = 0.35
    cameras: dict[str, CameraConfig] = field(
        default_factory=lambda: {"front": CameraConfig(84, 112), "wrist": CameraConfig(84, 84)}
    )

    def build(self) -> "PickPlaceEnv":
        return PickPlaceEnv(self)


class PickPlaceEnv(TabletopEnv):
    """See the module's docstring."""

    config: PickPlaceConfig

    def __init__(self, config: PickPlaceConfig) -> None:
        self.parcel, name = PARCELS[config.object], config.object.capitalize()
        absent = [other.capitalize() for other in PARCELS if other != config.object]
        view = View(eye=(0.92, 0.02, 1.75), at=(0.08, 0.02, 0.84), fovy=40)
        super().__init__(config, f"PickPlace{name}", self.parcel.names, view, absent=absent)
        self.tasks = pick_place_tasks(self.parcel)
        self._body, self._joint = self.body(f"{name}_main"), f"{name}_joint0"

    def _achieved(self) -> Array:
        return self.parcel.achieved_of(self.data.xpos[self._body], self.data.xmat[self._body].reshape(3, 3))

    def failure(self) -> str | None:
        achieved = self._achieved()
        left_alone = self.data.site_xpos[self._site, 2] > RIM + 0.1
        if left_alone and self.parcel.sunk(achieved):
            return f"the {self.parcel.name} lies in a compartment, too low for a gripper to take it out"
        return self.parcel.lost(achieved)

    def reached(self, achieved: Array, goal: Array) -> bool:
        off = achieved[:3] - goal[:3]
        there = np.hypot(*off[:2]) <= POSITION_TOLERANCE and abs(off[2]) <= HEIGHT_TOLERANCE
        return bool(there and abs(achieved[3] - goal[3]) <= UP_TOLERANCE)

    def _arrange(self, rng: np.random.Generator) -> None:
        super()._arrange(rng)
        if rng.random() < self.config.beyond and "take_out" in {task.kind for task in self.tasks.values()}:
            self.lay(np.array(_LAID[int(rng.integers(4))]) + rng.uniform(-0.01, 0.01, 2), rng.uniform(-np.pi, np.pi))

    def lay(self, xy: Array, yaw: float) -> None:
        """Stand it somewhere; for start states only."""
        self.put(self._joint, [*xy, FLOOR + self.parcel.below + 0.001], upright(yaw))


def compartment(achieved: Array) -> int | None:
    """In which of the four it is by robosuite's own test, or None."""
    for index, (x, y) in enumerate(_CENTERS):
        inside = abs(achieved[0] - x) < _HALF[0] and abs(achieved[1] - y) < _HALF[1]
        if inside and 0.8 < achieved[2] < 0.9:
            return index
    return None


def in_bin(achieved: Array) -> bool:
    """Whether it is in the first bin."""
    (x0, x1), (y0, y1) = LEFT_BIN
    return bool(x0 < achieved[0] < x1 and y0 < achieved[1] < y1 and achieved[2] < 0.9)


def pick_place_tasks(parcel: Parcel) -> Mapping[str, Task]:
    """Name -> task, in the order that reports use."""
    return MappingProxyType({task.name: task for task in _Tasks(parcel, list(PARCELS).index(parcel.name)).tasks()})


@dataclass(frozen=True)
class _Tasks:
    """The tasks of a parcel whose compartment is number `own`."""

    parcel: Parcel
    own: int

    def tasks(self) -> tuple[Task, ...]:
        name, others = self.parcel.name, tuple(i for i in range(len(_CENTERS)) if i != self.own)
        tasks = (
            Task(f"lift_{name}", "lift", self.here, _as_it_comes, self.lift, self.lifted),
            Task(f"place_{name}", "place", self.here, _as_it_comes, self.place, self.placed),
            Task(f"stow_{name}", "stow", self.here, _as_it_comes, self.into((self.own,)), _same),
            Task(f"misplace_{name}", "misplace", self.here, _as_it_comes, self.into(others), _same),
            Task(f"take_out_{name}", "take_out", self.takeable, self.stowed, self.place, self.placed),
        )
        sinks = FLOOR + self.parcel.below < RIM - PALM  # even standing, and nobody takes it out again
        return tasks[:4] if sinks else tasks

    def here(self, achieved: Array) -> bool:
        return in_bin(achieved) and self.lies(achieved)

    def lies(self, achieved: Array) -> bool:
        return bool(abs(achieved[2] - FLOOR - self.parcel.rest(achieved)) < 0.012)

    def takeable(self, achieved: Array) -> bool:
        return compartment(achieved) is not None and not self.parcel.sunk(achieved)

    def stowed(self, env: PickPlaceEnv, rng: np.random.Generator) -> None:
        env.lay(np.array(_LAID[self.own]) + rng.uniform(-0.01, 0.01, 2), rng.uniform(-np.pi, np.pi))
        env.refresh()

    def lift(self, achieved: Array, rng: np.random.Generator) -> Array:
        goal = achieved.copy()
        goal[2] += rng.uniform(0.08, 0.12)
        return goal

    def place(self, achieved: Array, rng: np.random.Generator) -> Array:
        (x0, x1), (y0, y1) = BIN
        for _ in range(100):
            spot = rng.uniform((x0, y0), (x1, y1))
            if np.hypot(*(spot - achieved[:2])) > 0.10:
                break
        return self._moved(achieved, spot)

    def into(self, indices: tuple[int, ...]) -> Callable[[Array, np.random.Generator], Array]:
        def command(achieved: Array, rng: np.random.Generator) -> Array:
            free = [i for i in indices if i != compartment(achieved)] or list(indices)
            spot = np.array(_LAID[free[int(rng.integers(len(free)))]])
            return self._moved(achieved, spot + rng.uniform(-0.01, 0.01, 2))

        return command

    def lifted(self, start: Array, achieved: Array, goal: Array) -> bool:
        return bool(achieved[2] > start[2] + LIFTED)

    def placed(self, start: Array, achieved: Array, goal: Array) -> bool:
        return bool(np.hypot(*(achieved[:2] - goal[:2])) < POSITION_TOLERANCE and self.lies(achieved))

    def _moved(self, achieved: Array, xy: Array) -> Array:
        goal = achieved.copy()
        goal[:2], goal[2] = xy, FLOOR + self.parcel.rest(achieved)
        return goal


def _same(start: Array, achieved: Array, goal: Array) -> bool:
    """In the compartment that the goal shows."""
    return compartment(achieved) is not None and compartment(achieved) == compartment(goal)


def _as_it_comes(env: Any, rng: np.random.Generator) -> None:
    """Nothing to bring about: most random starts suit."""


def _skill_library(env: Any) -> ParcelSkillLibrary:
    return ParcelSkillLibrary(env.parcel, env.tasks)


register_skill_library("pick_place", _skill_library)
