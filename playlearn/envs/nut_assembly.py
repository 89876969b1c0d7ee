"""robosuite's NutAssembly with one nut: onto its peg, off it again, about the table.

`achieved` (6,):

    nut.x nut.y nut.z      meters, the middle of its hole
    nut.c nut.s nut.slope  the direction its handle points in: (c, s) in the plane, slope upwards
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View, upright
from playlearn.episode import Array
from playlearn.oracles import register_skill_library
from playlearn.oracles.end_effector import CLOSE, OPEN, EndEffector, Style
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Reach, Skill, TiltedSkill, Waypoint, turn, up
from playlearn.sim.environment import EnvironmentConfig, Task

NAMES = ("nut.x", "nut.y", "nut.z", "nut.c", "nut.s", "nut.slope")
TABLE_Z, PEG_TOP = 0.82, 0.95
REST = TABLE_Z + 0.01
PEGS = {"square": (0.23, 0.10), "round": (0.23, -0.10)}
AREA = ((-0.17, 0.06), (-0.16, 0.22))  # x and y where a nut is laid
POSITION_TOLERANCE, HEIGHT_TOLERANCE, YAW_TOLERANCE = 0.03, 0.02, np.deg2rad(25.0)
ON_PEG = 0.03  # meters, robosuite's own
_HANDLE = 0.066  # meters from the hole to where the handle is gripped
_WIDTH = 0.032
_SHOULDER, _STRETCHED = (-0.56, 0.0), 0.71
_LOWEST, _HIGHEST = np.deg2rad(-20.0), np.deg2rad(290.0)  # yaws that a Panda's wrist can surely turn to
_NEAR, _NEAR_YAW = 0.02, 0.2


@EnvironmentConfig.register_subclass("nut_assembly")
@dataclass(frozen=True)
class NutAssemblyConfig(TabletopConfig):
    """nut: which of robosuite's two. beyond: share of random starts anywhere on the table; on_peg: on its peg.

    All others are robosuite's own.
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
    """Whether the nut is on its peg, as robosuite judges it."""
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


@dataclass(frozen=True)
class Bring:
    """Take the nut by its handle to where `goal` (G,) shows it: over the peg and down, or about the table.

    The handle makes every direction different, so the wrist must turn as far as the nut does: the hand takes it
    on that side from which it can.
    """

    name: str
    goal: tuple[float, ...]
    peg: tuple[float, float]

    @property
    def lasting(self) -> bool:
        return self.goal[2] < REST + 0.02

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        if held(hand, achieved):
            return self._bring(hand, achieved, style)
        falling = (
            self._threading and caught(achieved, self.peg, PEG_TOP - 0.06) and hand.position[2] < achieved[2] + 0.06
        )
        if self.lasting and (falling or self.there(achieved)):
            rise = up(0.08 if hand.opening > 0.05 else 0.0)
            return hand.pose(hand.position + rise, _down(hand.yaw), OPEN, style.speed)
        return self._fetch(hand, achieved, style)

    def there(self, achieved: Array) -> bool:
        off = achieved[:3] - self.goal[:3]
        loose = (
            2.0 if self._threading and on_peg(achieved, self.peg) else 1.0
        )  # it goes no further than its hole lets it
        turned = abs(turn(yaw(achieved), self._direction, 2 * np.pi))
        return bool(np.hypot(*off[:2]) < _NEAR and abs(off[2]) < 0.012 and turned < loose * _NEAR_YAW)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        if not self.lasting:
            return held(hand, achieved) and abs(float(achieved[2]) - self.goal[2]) < 0.015
        return self.there(achieved) and not held(hand, achieved) and hand.position[2] > self.goal[2] + 0.06

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return ()  # which way round a wrist turns cannot be told in waypoints

    @property
    def _direction(self) -> float:
        return float(np.arctan2(self.goal[4], self.goal[3]))

    @property
    def _threading(self) -> bool:
        return bool(np.abs(np.subtract(self.goal[:2], self.peg)).max() < ON_PEG and self.lasting)

    def _fetch(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        grip = handle(achieved)
        now, left = yaw(achieved), turn(yaw(achieved), self._direction, 2 * np.pi)
        wanted = min((_window(now + side) for side in (-np.pi / 2, np.pi / 2)), key=lambda way: _cost(way, left))
        off, turning = float(np.hypot(*(hand.position - grip)[:2])), wanted - _window(hand.yaw)
        rise = 4.0 * max(0.0, off - 0.008) + 0.15 * max(0.0, abs(turning) - 0.12)
        above = min(style.approach, rise)
        if hand.opening < _WIDTH + 0.012 and hand.position[2] > grip[2] + 0.02:
            above = max(above, 0.06)
        down = abs(hand.position[2] - grip[2]) < 0.010 and off < 0.014 and abs(turning) < 0.22
        place = grip + up(above)
        if hand.position[2] < place[2] - 0.02:
            place[:2] = hand.position[:2] + 0.3 * (place - hand.position)[:2]
        step = _window(hand.yaw) + float(np.clip(turning, -1.0, 1.0))
        return hand.pose(place, _down(step), CLOSE if down else OPEN, style.speed)

    def _bring(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        here, goal = achieved[:3].astype(float), np.array(self.goal[:3])
        mine = _window(hand.yaw)
        # Whichever way round the wrist can: half a turn away the nearer way would be another with every tremble.
        # Where no way leads quite there, it is laid down as near as can be and taken from its other side.
        end = _window(mine + turn(yaw(achieved), self._direction, 2 * np.pi))
        left = float(np.clip(end, _LOWEST, _HIGHEST)) - mine
        off = float(np.hypot(*(goal - here)[:2]))
        stuck = caught(achieved, self.peg)
        over = PEG_TOP + 0.035
        if self._threading:
            fits = off < (0.015 if stuck else 0.006) and (stuck or abs(left) < 0.3)
            height = REST + 0.01 if fits else over
            if fits and here[2] < PEG_TOP - 0.06:
                return hand.pose(hand.position, _down(mine), OPEN, style.speed)
        else:
            near = float(np.hypot(*(here[:2] - self.peg))) < 0.13
            lift = min(style.carry, 4.0 * max(0.0, off - 0.008) + 0.1 * max(0.0, abs(left) - 0.15))
            height = over if near else goal[2] + lift + 0.002
            if self.lasting and off < 0.014 and abs(left) < 0.15 and abs(here[2] - goal[2]) < 0.009:
                return hand.pose(hand.position, _down(mine), OPEN, style.speed)
        place = hand.position + np.array([*goal[:2], height]) - here
        if stuck and not (self._threading and fits):
            place[:2], left = hand.position[:2], 0.0  # straight up, off the peg
        elif height > here[2] + 0.02:
            place[:2] = hand.position[:2] + 0.15 * (place - hand.position)[:2]
        return hand.pose(place, _down(mine + float(np.clip(left, -1.0, 1.0))), CLOSE, style.speed)


def handle(achieved: Array) -> Array:
    """(3,) m, where the nut is gripped."""
    place: Array = achieved[:3] + _HANDLE * achieved[3:6].astype(float) + up(0.005)
    return place


def caught(achieved: Array, peg: tuple[float, float], below: float = PEG_TOP + 0.012) -> bool:
    """Whether the peg is in the nut, lower than `below` m."""
    return bool(np.hypot(*(achieved[:2] - peg)) < 0.05 and achieved[2] < below)


def held(hand: EndEffector, achieved: Array) -> bool:
    """Whether the nut's handle is between the fingers."""
    off = hand.position - handle(achieved)
    across = abs(turn(hand.yaw, yaw(achieved) + np.pi / 2, np.pi)) < 0.5
    between = _WIDTH - 0.010 < hand.opening < _WIDTH + 0.008
    return bool(between and across and np.hypot(*off[:2]) < 0.028 and abs(off[2]) < 0.025)


class NutSkillLibrary:
    """A `SkillLibrary`; see there."""

    idle = ((-0.15, -0.2, 1.0), (0.1, 0.25, 1.1))

    def __init__(self, peg: tuple[float, float]) -> None:
        self._peg, self._tasks = peg, nut_tasks(peg)

    def options(self) -> Sequence[SkillOption]:
        weights = {"lift": 0.6, "thread": 1.6, "take_off": 3.0}

        def option(task: Task) -> SkillOption:
            def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
                return self._bring(task.command(achieved, rng), task.name)

            return SkillOption(task.name, task.kind, task.precondition, skill, weights.get(task.kind, 1.0))

        return [option(task) for task in self._tasks.values()]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return held(hand, achieved)

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        name = "thread_nut" if rng.random() < 0.5 else "place_nut"
        return self._bring(self._tasks[name].command(achieved, rng), name)

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        bring = self._bring(goal, "bring_nut")
        if (
            held(hand, achieved)
            or not bring.lasting
            or not Bring("", tuple(map(float, goal)), self._peg).there(achieved)
        ):
            return bring
        x, y, _ = hand.position
        return Reach("rest", (float(x), float(y), TABLE_Z + 0.2))

    def _bring(self, goal: Array, name: str) -> Skill:
        return TiltedSkill(Bring(name, tuple(map(float, goal)), self._peg), _SHOULDER, _STRETCHED)


def _window(angle: float) -> float:
    """The same angle within the wrist's range, as far as it can be."""
    low = (_LOWEST + _HIGHEST) / 2 - np.pi
    return float((angle - low) % (2 * np.pi) + low)


def _cost(way: float, left: float) -> float:
    """How ill it suits to take the nut with the fingers along `way` rad, when it is to be turned by `left`."""
    end: float = _window(way + left)
    # What cannot be turned whole can be laid down on the way; what cannot be gripped cannot.
    out = 40.0 * _beyond(way) + 20.0 * _beyond(end)
    return out + abs(way - np.pi / 2) + abs(end - np.pi / 2)


def _beyond(angle: float) -> float:
    """How far it is outside of what the wrist can surely turn to, rad."""
    worst: float = max(0.0, _LOWEST - angle, angle - _HIGHEST)
    return worst


def _down(angle: float) -> Array:
    """(3, 3) of a hand that points down with its finger axis along `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


def _skill_library(env: Any) -> NutSkillLibrary:
    return NutSkillLibrary(PEGS[env.config.nut])


register_skill_library("nut_assembly", _skill_library)
