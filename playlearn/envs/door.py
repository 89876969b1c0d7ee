"""robosuite's Door: a door on a frictionless hinge, held shut by a latch that its lever turns.

`achieved` (6,):

    door.angle                     rad, 0 shut .. 0.4 open
    latch.angle                    rad that the lever is turned beyond the 0.11 within which friction lets it stay
    frame.x frame.y frame.c frame.s    meters, (cos, sin) yaw: where the frame stands; the same all through an episode

The lever lies along the door, `_ARM` from the latch's axis to where it is gripped; below 0.19 rad of door
the latch must be turned by 1.25 rad to pass its post, on the way out and on the way in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View
from playlearn.episode import Array
from playlearn.oracles import register_skill_library
from playlearn.oracles.end_effector import CLOSE, OPEN, EndEffector, Style
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Skill, Waypoint
from playlearn.sim.environment import EnvironmentConfig, Task

NAMES = ("door.angle", "latch.angle", "frame.x", "frame.y", "frame.c", "frame.s")
ANGLE, LATCH = 0, 1
TOLERANCE = 0.06  # rad
OPENED, SHUT = 0.3, 0.03  # rad; the first is robosuite's own
MOST = 0.4
_PLAY = 0.11  # rad of lever that are called 0
_FRAME_Z = 1.1
_ARM = 0.10
_LATCHED, _TURNED = 0.19, 1.27  # rad of door below which, and of lever from which on, the latch passes
_UP = -1.4  # rad to which it is turned: upwards, where the wrist has room
_NEAR, _STAYS = 0.02, 0.045  # rad within which the lever is let go, and beyond which it is taken again


@EnvironmentConfig.register_subclass("door")
@dataclass(frozen=True)
class DoorConfig(TabletopConfig):
    """robosuite's Door.

    opened: fraction of random starts with the door open at a random angle; in all others it is shut, as in robosuite.
    """

    opened: float = 0.5

    def build(self) -> "DoorEnv":
        return DoorEnv(self)


class DoorEnv(TabletopEnv):
    """See the module's docstring."""

    config: DoorConfig

    def __init__(self, config: DoorConfig) -> None:
        view = View(eye=(0.45, 0.45, 1.65), at=(-0.17, -0.2, 1.05), fovy=38)
        super().__init__(config, "Door", NAMES, view, standing=("Door",))
        self.tasks = door_tasks()
        self._hinge = int(self.model.joint("Door_hinge").qposadr[0])
        self._latch = int(self.model.joint("Door_latch_joint").qposadr[0])
        self._frame = self.body("Door_frame")

    def _achieved(self) -> Array:
        latch = self.data.qpos[self._latch]
        turned = np.sign(latch) * max(0.0, abs(latch) - _PLAY)
        c, s = self.data.xmat[self._frame].reshape(3, 3)[:2, 0]
        return np.array([self.data.qpos[self._hinge], turned, *self.data.xpos[self._frame][:2], c, s], np.float32)

    def failure(self) -> str | None:
        return None  # nothing can be lost

    def reached(self, achieved: Array, goal: Array) -> bool:
        return bool(abs(achieved[ANGLE] - goal[ANGLE]) < TOLERANCE)

    def _arrange(self, rng: np.random.Generator) -> None:
        super()._arrange(rng)
        if rng.random() < self.config.opened:
            self.swing(rng.uniform(_LATCHED, MOST))

    def swing(self, angle: float) -> None:
        """Set the door's angle in rad; for start states only."""
        self.data.qpos[self._hinge] = angle


def door_tasks() -> Mapping[str, Task]:
    """Name -> task."""

    def task(name: str, suits: Any, before: tuple[float, float], after: tuple[float, float], judge: Any) -> Task:
        def arrange(env: DoorEnv, rng: np.random.Generator) -> None:
            env.swing(rng.uniform(*before))
            env.refresh()

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[ANGLE] = rng.uniform(*after)
            if abs(goal[ANGLE] - achieved[ANGLE]) < 2 * TOLERANCE:  # swing: as far on the other side
                goal[ANGLE] = after[0] if achieved[ANGLE] > np.mean(after) else after[1]
            goal[LATCH] = 0.0
            return goal

        return Task(name, name.partition("_")[0], suits, arrange, command, judge)

    def near(start: Array, achieved: Array, goal: Array) -> bool:
        return bool(abs(achieved[ANGLE] - goal[ANGLE]) < TOLERANCE)

    def opened(start: Array, achieved: Array, goal: Array) -> bool:
        return bool(achieved[ANGLE] > OPENED)

    def shut(start: Array, achieved: Array, goal: Array) -> bool:
        return bool(achieved[ANGLE] < SHUT)

    is_open = lambda achieved: bool(achieved[ANGLE] > _LATCHED)  # noqa: E731
    tasks = (
        task("open_door", lambda achieved: bool(achieved[ANGLE] < SHUT), (0.0, 0.0), (0.34, 0.39), opened),
        task("shut_door", is_open, (_LATCHED, MOST), (0.0, 0.0), shut),
        task("swing_door", is_open, (_LATCHED, MOST), (0.21, 0.38), near),
    )
    return MappingProxyType({task.name: task for task in tasks})


@dataclass(frozen=True)
class Swing:
    """Take the door by its lever, turn it where the latch is in the way, and bring the door to `angle` rad."""

    name: str
    angle: float
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        angle, latch = float(achieved[ANGLE]), _lever(achieved)
        left = self.angle - angle
        place, rotation = grip(achieved, angle, latch)
        off = rotation.T @ (hand.position - place)  # (3,) across the lever, along it, towards the door
        aligned = np.trace(rotation.T @ hand.rotation) > 2.6  # within some 37 degrees
        if aligned and 0.028 < hand.opening < 0.052 and np.abs(off).max() < 0.03:
            return self._lead(hand, achieved, angle, latch, style)
        if abs(left) <= _STAYS:
            loose = hand.opening > 0.055 and np.linalg.norm(off) < 0.12
            back = rotation[:, 2] * (0.05 if loose else 0.0)
            return hand.pose(hand.position - back, hand.rotation, OPEN, style.speed)
        miss = float(np.hypot(off[0], off[1]))
        away = min(0.10, 4.0 * max(0.0, miss - 0.01)) if aligned else 0.16
        close = aligned and miss < 0.02 and abs(off[2]) < 0.015
        return hand.pose(place - rotation[:, 2] * away, rotation, CLOSE if close else OPEN, style.speed)

    def _lead(self, hand: EndEffector, achieved: Array, angle: float, latch: float, style: Style) -> Array:
        """While the gripper holds the lever."""
        left = self.angle - angle
        if abs(left) <= _NEAR:
            if abs(latch) < 0.25:
                return hand.pose(hand.position, hand.rotation, OPEN, style.speed)
            eased = latch - float(np.clip(latch, -0.3, 0.3))  # let go of a turned lever, it would kick the door
            return hand.pose(*grip(achieved, self.angle, eased), CLOSE, style.speed)
        barred = min(angle, self.angle) < _LATCHED
        turned = latch + float(np.clip(_UP - latch, -0.3, 0.3)) if barred else latch
        free = not barred or abs(latch) > _TURNED
        if not free:  # meanwhile the door waits where the latch is clear of its post
            left = (0.24 if angle > 0.1 else -0.02) - angle
        swung = angle + float(np.clip(1.5 * left + 0.03 * np.sign(left), -0.09, 0.09))
        return hand.pose(*grip(achieved, swung, turned), CLOSE, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        place, rotation = grip(achieved, float(achieved[ANGLE]), _lever(achieved))
        clear = (rotation.T @ (hand.position - place))[2] < -0.09
        return bool(clear and abs(self.angle - achieved[ANGLE]) <= _STAYS)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return ()  # the gripper does not point down, and the lever takes feedback


class DoorSkillLibrary:
    """The `SkillLibrary` of the door."""

    idle = ((-0.25, -0.05, 1.0), (0.0, 0.15, 1.15))

    def __init__(self) -> None:
        self._tasks = door_tasks()

    def options(self) -> Sequence[SkillOption]:
        def option(task: Task) -> SkillOption:
            def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
                return Swing(task.name, float(task.command(achieved, rng)[ANGLE]))

            return SkillOption(task.name, task.kind, task.precondition, skill)

        return [option(task) for task in self._tasks.values()]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return False

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        return self.towards(hand, achieved, achieved)

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        return Swing("swing_door", float(goal[ANGLE]))


def grip(achieved: Array, angle: float, latch: float) -> tuple[Array, Array]:
    """The gripper's grasp of the lever, (3,) m and rotation (3, 3), were the door at `angle` and it at `latch` rad."""
    x, y, c, s = (float(v) for v in achieved[2:])
    frame = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    swung = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    along = np.array([np.cos(latch), 0.0, -np.sin(latch)])
    lever = np.array([-0.43, -0.1, -0.025]) + _ARM * along  # from the hinge
    place = np.array([x, y, _FRAME_Z]) + frame @ (np.array([0.555, 0.0, 0.0]) + swung @ lever)
    turn = frame @ swung
    inwards, u = turn @ np.array([0.0, 1.0, 0.0]), turn @ along
    across = np.cross(inwards, u)  # at rest straight up or down
    return place, np.stack([across, np.cross(inwards, across), inwards], axis=1)


def _lever(achieved: Array) -> float:
    """rad that the lever is turned, as far as `achieved` tells it."""
    beyond = float(achieved[LATCH])
    return beyond + float(np.sign(beyond)) * _PLAY


register_skill_library("door", lambda _: DoorSkillLibrary())
