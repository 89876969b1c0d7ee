"""robosuite's NutAssembly with one nut: onto its peg, off it again, about the table.

`achieved` (6,):

    nut.x nut.y nut.z      meters, the middle of its hole
    nut.c nut.s nut.slope  the direction its handle points in: (c, s) in the plane, slope upwards
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View, upright
from playlearn.episode import Array
from playlearn.oracles.skills import turn
from playlearn.sim.environment import EnvironmentConfig, Task

NAMES = ("nut.x", "nut.y", "nut.z", "nut.c", "nut.s", "nut.slope")
TABLE_Z, PEG_TOP = 0.82, 0.95
REST = TABLE_Z + 0.01
PEGS = {"square": (0.23, 0.10), "round": (0.23, -0.10)}
AREA = ((-0.17, 0.06), (-0.16, 0.22))  # x and y where a nut is laid
POSITION_TOLERANCE, HEIGHT_TOLERANCE, YAW_TOLERANCE = 0.03, 0.02, np.deg2rad(25.0)
ON_PEG = 0.03  # meters, robosuite's own


@EnvironmentConfig.register_subclass("nut_assembly")
@dataclass(frozen=True)
class NutAssemblyConfig(TabletopConfig):
    """robosuite's NutAssembly with one nut.

    nut: which of robosuite's two.
    beyond: fraction of random starts with the nut anywhere on the table.
    on_peg: fraction with the nut on its peg; all others are robosuite's own.
    """

    nut: Literal["square", "round"] = "square"
    beyond: float = 0.3
    on_peg: float = 0.25

    def build(self) -> "NutAssemblyEnv":
        return NutAssemblyEnv(self)


class NutAssemblyEnv(TabletopEnv):
    """See the module's docstring."""

    config: NutAssemblyConfig

    def __init__(self, config: NutAssemblyConfig) -> None:
        view = View(eye=(0.80, 0.05, 1.50), at=(0.03, 0.04, 0.86), fovy=37)
        name, other = (f"{nut.capitalize()}Nut" for nut in (config.nut, *(set(PEGS) - {config.nut})))
        super().__init__(config, f"NutAssembly{config.nut.capitalize()}", NAMES, view, absent=(other,))
        self.tasks = nut_tasks(PEGS[config.nut])
        self._body, self._joint = self.body(f"{name}_main"), f"{name}_joint0"

    def _achieved(self) -> Array:
        return np.array([*self.data.xpos[self._body], *self.data.xmat[self._body].reshape(3, 3)[:, 0]], np.float32)

    def failure(self) -> str | None:
        x, y, z = self.data.xpos[self._body]
        if z < TABLE_Z - 0.03:
            return "the nut fell off the table"
        if abs(y) > 0.34 or x < -0.34 or x > 0.3:
            return "the nut is out of reach"
        return None

    def reached(self, achieved: Array, goal: Array) -> bool:
        off = achieved[:3] - goal[:3]
        there = np.hypot(*off[:2]) < POSITION_TOLERANCE and abs(off[2]) < HEIGHT_TOLERANCE
        return bool(there and abs(turn(yaw(achieved), yaw(goal), 2 * np.pi)) < YAW_TOLERANCE)

    def _arrange(self, rng: np.random.Generator) -> None:
        super()._arrange(rng)
        draw = rng.random()
        if draw < self.config.beyond:
            self.lay(rng.uniform(*np.transpose(AREA)), rng.uniform(-np.pi, np.pi))
        elif draw < self.config.beyond + self.config.on_peg:
            self.thread(rng)

    def lay(self, xy: Array, direction: float) -> None:
        """Lay the nut on the table, its handle in a direction in rad; for start states only."""
        self.put(self._joint, [*xy, REST + 0.001], upright(direction))

    def thread(self, rng: np.random.Generator) -> None:
        """Put the nut on its peg; for start states only."""
        peg = np.array(PEGS[self.config.nut])
        self.lay(peg + rng.uniform(-0.003, 0.003, 2), np.pi + rng.uniform(-0.8, 0.8))


def yaw(achieved: Array) -> float:
    """Where the handle points, rad."""
    return float(np.arctan2(achieved[4], achieved[3]))


def on_peg(achieved: Array, peg: tuple[float, float]) -> bool:
    """Whether the nut is on its peg, by robosuite's own test."""
    return bool(np.abs(achieved[:2] - peg).max() < ON_PEG and achieved[2] < TABLE_Z + 0.05)


def nut_tasks(peg: tuple[float, float]) -> Mapping[str, Task]:
    """Name -> task, in the order that reports use."""
    return MappingProxyType({task.name: task for task in _Tasks(peg).tasks()})


@dataclass(frozen=True)
class _Tasks:
    """The tasks of a nut whose peg is at `peg` (2,) m."""

    peg: tuple[float, float]

    def tasks(self) -> tuple[Task, ...]:
        return (
            Task("lift_nut", "lift", self.lies, _as_it_comes, self.lift, _lifted),
            Task("place_nut", "place", self.lies, _as_it_comes, self.place, self.near),
            Task("rotate_nut", "rotate", self.lies, _as_it_comes, self.rotate, self.turned),
            Task("thread_nut", "thread", self.lies, _as_it_comes, self.thread, self.fitted),
            Task("take_off_nut", "take_off", self.sits, _threaded, self.place, self.near),
        )

    def lies(self, achieved: Array) -> bool:
        return bool(abs(achieved[2] - REST) < 0.008 and abs(achieved[5]) < 0.1 and not self.sits(achieved))

    def sits(self, achieved: Array) -> bool:
        return on_peg(achieved, self.peg)

    def lift(self, achieved: Array, rng: np.random.Generator) -> Array:
        return _at(achieved[:2], REST + rng.uniform(0.08, 0.12), yaw(achieved))

    def place(self, achieved: Array, rng: np.random.Generator) -> Array:
        for _ in range(100):
            spot = rng.uniform(*np.transpose(AREA))
            if np.hypot(*(spot - achieved[:2])) > 0.10:
                break
        return _at(spot, REST, yaw(achieved) + rng.uniform(-1.0, 1.0))

    def rotate(self, achieved: Array, rng: np.random.Generator) -> Array:
        return _at(achieved[:2], REST, yaw(achieved) + rng.choice([-1, 1]) * rng.uniform(0.7, 1.4))

    def thread(self, achieved: Array, rng: np.random.Generator) -> Array:
        return _at(self.peg, REST, np.pi + rng.uniform(-0.5, 0.5))

    def near(self, start: Array, achieved: Array, goal: Array) -> bool:
        return bool(np.hypot(*(achieved[:2] - goal[:2])) < 0.04 and self.lies(achieved))

    def turned(self, start: Array, achieved: Array, goal: Array) -> bool:
        off = turn(yaw(achieved), yaw(goal), 2 * np.pi)
        return self.near(start, achieved, goal) and abs(off) < YAW_TOLERANCE

    def fitted(self, start: Array, achieved: Array, goal: Array) -> bool:
        return self.sits(achieved)


def _at(xy: Any, z: float, direction: float) -> Array:
    return np.array([*xy, z, np.cos(direction), np.sin(direction), 0.0], np.float32)


def _lifted(start: Array, achieved: Array, goal: Array) -> bool:
    return bool(achieved[2] > start[2] + 0.04)


def _as_it_comes(env: NutAssemblyEnv, rng: np.random.Generator) -> None:
    """Nothing to bring about: most random starts suit."""


def _threaded(env: NutAssemblyEnv, rng: np.random.Generator) -> None:
    env.thread(rng)
    env.refresh()
