"""How the nut is moved by its handle: the skill, and the skill library of play and the expert."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.envs.nut_assembly.env import ON_PEG, PEG_TOP, PEGS, REST, TABLE_Z, nut_tasks, on_peg, yaw
from playlearn.episode import Array
from playlearn.oracles import register_skill_library
from playlearn.oracles.end_effector import CLOSE, OPEN, EndEffector, Style
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Reach, Skill, TiltedSkill, Waypoint, turn, up
from playlearn.sim.environment import Task

_HANDLE = 0.066  # meters from the hole to where the handle is gripped
_WIDTH = 0.032
_SHOULDER, _STRETCHED = (-0.56, 0.0), 0.71
_LOWEST, _HIGHEST = np.deg2rad(-20.0), np.deg2rad(290.0)  # yaws that a Panda's wrist can surely turn to
_NEAR, _NEAR_YAW = 0.02, 0.2


@dataclass(frozen=True)
class Bring:
    """Take the nut by its handle to where `goal` (G,) shows it: over the peg and down, or about the table.

    The handle makes every direction different, so the wrist must turn as far as the nut does: the gripper takes it
    on the side from which it can.
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
        )  # it turns no farther than its hole allows
        turned = abs(turn(yaw(achieved), self._direction, 2 * np.pi))
        return bool(np.hypot(*off[:2]) < _NEAR and abs(off[2]) < 0.012 and turned < loose * _NEAR_YAW)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        if not self.lasting:
            return held(hand, achieved) and abs(float(achieved[2]) - self.goal[2]) < 0.015
        return self.there(achieved) and not held(hand, achieved) and hand.position[2] > self.goal[2] + 0.06

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return ()  # waypoints cannot tell which way round a wrist turns

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
    """The `SkillLibrary` of one nut."""

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
    """Cost of taking the nut with the fingers along `way` rad, when it is to be turned by `left` rad."""
    end: float = _window(way + left)
    # What cannot be turned whole can be laid down on the way; what cannot be gripped cannot.
    out = 40.0 * _beyond(way) + 20.0 * _beyond(end)
    return out + abs(way - np.pi / 2) + abs(end - np.pi / 2)


def _beyond(angle: float) -> float:
    """How far it is outside the wrist's sure range, rad."""
    worst: float = max(0.0, _LOWEST - angle, angle - _HIGHEST)
    return worst


def _down(angle: float) -> Array:
    """(3, 3) of a gripper that points down with its finger axis along `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


def _skill_library(env: Any) -> NutSkillLibrary:
    return NutSkillLibrary(PEGS[env.config.nut])


register_skill_library("nut_assembly", _skill_library)
