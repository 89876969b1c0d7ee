"""Closed-loop skills: each is a function of the present observation and of its own goal.

None has a memory, so each can take over from any state, and recovers from a slip or a miss.
`act` gives the action, `done` whether the outcome is there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from playlearn.episode import Array
from playlearn.oracles.end_effector import CLOSE, OPEN, REST_YAW, EndEffector, Style

NEAR, NEAR_HEIGHT, NEAR_YAW = 0.025, 0.012, 0.25  # meters and radians within which an object is where it should be


@dataclass(frozen=True)
class Waypoint:
    """A stop of a plan.

    position: (3,) m of the end effector.
    yaw: of its finger axis, rad.
    grip: command of the gripper, OPEN or CLOSE.
    wait: steps for which it stays there.
    """

    position: tuple[float, float, float]
    yaw: float
    grip: float
    wait: int = 0


class Skill(Protocol):
    """One target_object that play or the expert does.

    name: the annotation that is recorded.
    lasting: whether its outcome stays by itself, as that of a lift does not.
    """

    @property
    def name(self) -> str: ...

    @property
    def lasting(self) -> bool: ...

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array: ...

    def done(self, hand: EndEffector, achieved: Array) -> bool: ...

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        """The same as an open-loop plan; () where there can be none."""
        ...


class GraspableObject(Protocol):
    """Something that a gripper can take, carry and put down, read off `achieved`."""

    @property
    def symmetry(self) -> float:
        """Turned by so many radians it is the same again; 0 where its yaw does not matter at all."""
        ...

    def position(self, achieved: Array) -> Array:
        """(3,) m, of its center."""
        ...

    def yaw(self, achieved: Array) -> float:
        """Where it points, rad, modulo `symmetry`."""
        ...

    def grasp(self, hand: EndEffector, achieved: Array) -> tuple[Array, float]:
        """Where to grip it: (3,) m, and the yaw of the finger axis in rad."""
        ...

    def held(self, hand: EndEffector, achieved: Array) -> bool:
        """Whether it is between closed fingers."""
        ...

    def clearance(self, place: Array, height: float) -> float:
        """How far above `place` (3,) to travel, where `height` m would do on an empty table."""
        ...


@dataclass(frozen=True)
class Carry:
    """Grasp an object, bring its center to `position` and turn it to `yaw`; let go there, or hold it.

    position: (3,) m.
    yaw: rad.
    lasting: whether it is let go.
    drop: meters above `position` at which it is let go.
    room: meters that the fingers must be open before they go down around it; half closed they would press on its
        top, and friction would keep them so.
    slack: meters beside the grip within which they still go down around it.
    """

    name: str
    target_object: GraspableObject
    position: tuple[float, float, float]
    yaw: float
    lasting: bool = True
    drop: float = 0.002
    room: float = 0.0
    slack: float = 0.008

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        if self.target_object.held(hand, achieved):
            return self._bring(hand, achieved, style)
        if self.lasting and self._there(achieved):
            return self._leave(hand, achieved, style)
        return self._fetch(hand, achieved, style)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        held = self.target_object.held(hand, achieved)
        if not self.lasting:
            return held and abs(self.target_object.position(achieved)[2] - self.position[2]) < 0.015
        return self._there(achieved) and not held and hand.position[2] > self.position[2] + 0.06

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        grip, yaw = self.target_object.grasp(hand, achieved)
        target = np.array(self.position) + grip - self.target_object.position(achieved) + up(self.drop)
        turned = yaw + self._turn(achieved)
        away = target + up(self.target_object.clearance(target, style.carry))
        taking = (
            waypoint(grip + up(self.target_object.clearance(grip, style.approach)), yaw, OPEN),
            waypoint(grip, yaw, OPEN, wait=1),
            waypoint(grip, yaw, CLOSE, wait=5),
        )
        bringing = (
            waypoint(grip + up(self.target_object.clearance(grip, style.carry)), yaw, CLOSE),
            waypoint(away, turned, CLOSE),
            waypoint(target, turned, CLOSE, wait=2),
        )
        leaving = (waypoint(target, turned, OPEN, wait=4), waypoint(away, turned, OPEN))
        held = self.target_object.held(hand, achieved)
        return (*(() if held else taking), *bringing, *(leaving if self.lasting else ()))

    def _there(self, achieved: Array) -> bool:
        off = self.target_object.position(achieved) - self.position
        near = np.hypot(*off[:2]) < NEAR and abs(off[2]) < NEAR_HEIGHT
        return bool(near and abs(self._turn(achieved)) < NEAR_YAW)

    def _turn(self, achieved: Array) -> float:
        """How far it still has to be turned, rad."""
        return turn(self.target_object.yaw(achieved), self.yaw, self.target_object.symmetry)

    def _fetch(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        grip, wanted = self.target_object.grasp(hand, achieved)
        off = np.hypot(*(hand.position - grip)[:2])
        turning = hand.yaw_error(wanted)
        rise = 0.032 * max(0.0, off / self.slack - 1) + 0.15 * max(0.0, turning - 0.12)
        above = min(self.target_object.clearance(grip, style.approach), rise)
        if hand.opening < self.room and hand.position[2] > grip[2] + 0.02:
            above = max(above, 0.06)
        down = abs(hand.position[2] - grip[2]) < 0.012 and off < 0.014 and turning < 0.22
        at_height = grip + up(above)
        if hand.position[2] < at_height[2] - 0.02:  # rise before moving sideways, or it is knocked over
            at_height[:2] = _sidling(hand.position, at_height)
        return hand.move(at_height, wanted, CLOSE if down else OPEN, style.speed)

    def _bring(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        here, target = self.target_object.position(achieved), np.array(self.position)
        goal = target + up(self.drop)
        off, turning = np.hypot(*(goal - here)[:2]), self._turn(achieved)
        high = max(self.target_object.clearance(target, style.carry), self.target_object.clearance(here, style.carry))
        above = min(high, 4.0 * max(0.0, off - 0.008) + 0.10 * max(0.0, abs(turning) - 0.15))
        placed = off < 0.014 and abs(turning) < 0.18 and abs(here[2] - goal[2]) < 0.009
        yaw = hand.yaw + turning
        wanted = hand.position + goal + up(above) - here
        if self.lasting and placed:
            return hand.move(wanted, yaw, OPEN, style.speed)
        if wanted[2] > hand.position[2] + 0.02:
            wanted[:2] = _sidling(hand.position, wanted)
        return hand.move(wanted, yaw, CLOSE, style.speed)

    def _leave(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        away = hand.position + up(0.08 if hand.opening > 0.05 else 0.0)
        grip = self.target_object.grasp(hand, achieved)[0][:2]
        if np.hypot(*(grip - hand.position[:2])) < 0.03:  # straight up, wherever the arm may drift
            away[:2] = grip
        return hand.move(away, hand.yaw, OPEN, style.speed)


@dataclass(frozen=True)
class Push:
    """Push an object along what it lies on, with closed fingers turned across the way.

    position: (3,) m, its goal.
    behind: meters behind its center at which the fingers come down.
    """

    name: str
    target_object: GraspableObject
    position: tuple[float, float, float]
    lasting: bool = True
    behind: float = 0.062

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        here, way, left, yaw = self._course(achieved)
        low = max(here[2], self.position[2])
        across = np.array([-way[1], way[0]])
        offset = hand.position[:2] - here[:2]
        along, aside = float(offset @ way), float(offset @ across)
        if left < 0.016:
            return hand.move(np.array([*hand.position[:2], low + 0.12]), yaw, CLOSE, style.speed)
        if hand.position[2] < low + 0.012 and along < -0.025 and abs(aside) < 0.02:
            target = here[:2] + way * (min(left, 0.05) - 0.02) - 1.5 * aside * across
            return hand.move(np.array([*target, low]), yaw, CLOSE, 0.6 * style.speed)
        start = here[:2] - self.behind * way
        miss = float(np.hypot(*(hand.position[:2] - start)))
        above = min(style.approach, 4.0 * max(0.0, miss - 0.010))
        return hand.move(np.array([*start, low + above]), yaw, CLOSE, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        here, _, left, _ = self._course(achieved)
        return bool(left < 0.03 and hand.position[2] > here[2] + 0.07)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        here, way, _, yaw = self._course(achieved)
        start = np.array([*(here[:2] - self.behind * way), here[2]])
        end = np.array([*(np.array(self.position[:2]) - 0.03 * way), here[2]])
        stops = (start + up(style.approach), start, end, end + up(0.1))
        return tuple(waypoint(place, yaw, CLOSE) for place in stops)

    def _course(self, achieved: Array) -> tuple[Array, Array, float, float]:
        """The object's position (3,) m, the direction (2,) and distance in m to its goal, the fingers' yaw in rad."""
        here = self.target_object.position(achieved)
        away = np.array(self.position[:2]) - here[:2]
        left = float(np.linalg.norm(away))
        return here, away / max(left, 1e-6), left, float(np.arctan2(away[1], away[0]) + np.pi / 2)


@dataclass(frozen=True)
class Reach:
    """Move the empty gripper to `position` (3,) m, without purpose, as people do between two skills."""

    name: str
    position: tuple[float, float, float]
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        return hand.move(np.array(self.position), REST_YAW, OPEN, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return bool(np.linalg.norm(hand.position - self.position) < 0.03)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return (Waypoint(self.position, REST_YAW, OPEN),)


def _sidling(here: Array, there: Array) -> Array:
    """(2,) where to aim at in the plane while rising: little aside, but enough to hold against an arm that drifts."""
    way = (there - here)[:2]
    aim: Array = here[:2] + way * min(1.0, 0.02 / max(float(np.hypot(*way)), 1e-9))
    return aim


@dataclass(frozen=True)
class TiltedSkill:
    """A skill done with an end effector that leans outwards, the more the farther it is from the shoulder.

    An arm whose gripper points straight down is stretched a little beyond `near`. A stretched arm is singular: its
    elbow may bend either way.

    shoulder: (2,) m.
    near: meters from the shoulder beyond which it leans.
    max_lean: rad.
    hand_length: meters over which it leans by one rad more.
    """

    skill: Skill
    shoulder: tuple[float, float]
    near: float
    max_lean: float = 0.45
    hand_length: float = 0.2

    @property
    def name(self) -> str:
        return self.skill.name

    @property
    def lasting(self) -> bool:
        return self.skill.lasting

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        out = hand.position[:2] - self.shoulder
        away = float(np.linalg.norm(out))
        lean = min(self.max_lean, max(0.0, (away - self.near) / self.hand_length))  # rad
        x, y = out / max(away, 1e-6)
        c, s = np.cos(lean), np.sin(lean)
        tilt = np.array(
            [
                [c + y * y * (1 - c), -x * y * (1 - c), -x * s],
                [-x * y * (1 - c), c + x * x * (1 - c), -y * s],
                [x * s, y * s, c],
            ]
        )  # about (y, -x, 0)
        upright = EndEffector(hand.position, tilt.T @ hand.rotation, hand.opening, float(np.arctan2(y, x) + np.pi / 2))
        action = self.skill.act(upright, achieved, style)
        action[3:6] = (tilt @ action[3:6]).clip(-1, 1)
        return action

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return self.skill.done(hand, achieved)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        return self.skill.plan(hand, achieved, style)


def waypoint(position: Array, yaw: float, grip: float, wait: int = 0) -> Waypoint:
    """A waypoint at position (3,) m."""
    x, y, z = map(float, position)
    return Waypoint((x, y, z), yaw, grip, wait)


def turn(yaw: float, wanted: float, symmetry: float) -> float:
    """The shortest turn in rad from `yaw` to `wanted`, for an object that is the same again after `symmetry`."""
    if symmetry == 0:
        return 0.0
    return float((wanted - yaw + symmetry / 2) % symmetry - symmetry / 2)


def up(height: float) -> Array:
    """(3,) `height` meters upwards."""
    return np.array([0.0, 0.0, height])
