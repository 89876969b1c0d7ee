"""Closed-loop skills on PlayTable: each is a function of what is seen now and of what it is to bring about.

None remembers anything, so each can take over from any state, and after a slip or a miss it simply
does what that state asks for. `act` gives the action, `done` says whether its outcome is there.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from playlearn.episode import Array
from playlearn.sim import playtable_scene as scene
from playlearn.sim.playtable_tasks import DRAWER, LAMP, block, direction, in_tray
from playlearn.teleop.hand import CLOSE, OPEN, REST_YAW, Hand, Style

HIGH = scene.TABLE_Z + 0.14
POST_GRIP_Z = scene.POST_TOP - 0.015
TIP = 0.005  # metres from the grip site down to where the fingers touch


class Skill(Protocol):
    """One thing a teleoperator does. name: the annotation that is recorded."""

    @property
    def name(self) -> str: ...

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array: ...

    def done(self, hand: Hand, achieved: Array) -> bool: ...


def holding(hand: Hand, achieved: Array, index: int) -> bool:
    """Whether block `index` is between closed fingers."""
    off = hand.position - block(achieved, index)[:3]
    return bool(0.028 < hand.opening < 0.050 and np.hypot(*off[:2]) < 0.03 and abs(off[2]) < 0.03)


@dataclass(frozen=True)
class Carry:
    """Grasp block `index`, bring its centre to `position` (3,) m and its long axis to `yaw` rad; let go or hold."""

    name: str
    index: int
    position: tuple[float, float, float]
    yaw: float
    release: bool = True

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        pose = block(achieved, self.index)
        here, target = pose[:3].astype(float), np.array(self.position)
        if holding(hand, achieved, self.index):
            return self._bring(hand, here, target, direction(pose), style)
        if self.release and self._there(achieved):
            return self._leave(hand, style)
        return self._fetch(hand, here, direction(pose), in_tray(achieved, self.index), style)

    def done(self, hand: Hand, achieved: Array) -> bool:
        held = holding(hand, achieved, self.index)
        if not self.release:
            return held and abs(block(achieved, self.index)[2] - self.position[2]) < 0.015
        return self._there(achieved) and not held and hand.position[2] > self.position[2] + 0.06

    def _there(self, achieved: Array) -> bool:
        pose = block(achieved, self.index)
        off = (direction(pose) - self.yaw + np.pi / 2) % np.pi - np.pi / 2
        near = np.hypot(*(pose[:2] - self.position[:2])) < 0.025 and abs(pose[2] - self.position[2]) < 0.012
        return bool(near and abs(off) < 0.25)

    def _fetch(self, hand: Hand, here: Array, yaw: float, stowed: bool, style: Style) -> Array:
        grip = here + _up(0.012 if stowed else 0.0)
        wanted = yaw + np.pi / 2
        off = np.hypot(*(hand.position - grip)[:2])
        turn = hand.yaw_error(wanted)
        rise = 4.0 * max(0.0, off - 0.008) + 0.15 * max(0.0, turn - 0.12)
        above = min(_clearance(here, style.approach), rise)
        down = abs(hand.position[2] - grip[2]) < 0.012 and off < 0.014 and turn < 0.22
        at_height = grip + _up(above)
        if hand.position[2] < at_height[2] - 0.02:  # rise before moving sideways, or a block is knocked over
            at_height[:2] = hand.position[:2] + 0.3 * (at_height - hand.position)[:2]
        return hand.move(at_height, wanted, CLOSE if down else OPEN, style.speed)

    def _bring(self, hand: Hand, here: Array, target: Array, yaw: float, style: Style) -> Array:
        stowing = target[1] > 0.08 and target[2] < scene.TABLE_Z + 0.05
        goal = target + _up(0.01 if stowing else 0.002)
        off = np.hypot(*(goal - here)[:2])
        turn = (self.yaw - yaw + np.pi / 2) % np.pi - np.pi / 2
        high = max(_clearance(target, style.carry), _clearance(here, style.carry))
        above = min(high, 4.0 * max(0.0, off - 0.008) + 0.10 * max(0.0, abs(turn) - 0.15))
        placed = off < 0.014 and abs(turn) < 0.18 and abs(here[2] - goal[2]) < 0.009
        if self.release and placed:
            return hand.move(hand.position, self.yaw + np.pi / 2, OPEN, style.speed)
        wanted = hand.position + goal + _up(above) - here
        if wanted[2] > hand.position[2] + 0.02:
            wanted[:2] = hand.position[:2] + 0.15 * (wanted - hand.position)[:2]
        return hand.move(wanted, self.yaw + np.pi / 2, CLOSE, style.speed)

    def _leave(self, hand: Hand, style: Style) -> Array:
        up = hand.position + _up(0.08 if hand.opening > 0.05 else 0.0)
        return hand.move(up, hand.yaw, OPEN, style.speed)


@dataclass(frozen=True)
class Push:
    """Push block `index` along the table to `position` (2,) m with closed fingers."""

    name: str
    index: int
    position: tuple[float, float]

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        pose = block(achieved, self.index)
        here = pose[:2].astype(float)
        way = np.array(self.position) - here
        left = float(np.linalg.norm(way))
        way = way / max(left, 1e-6)
        across = np.array([-way[1], way[0]])
        offset = hand.position[:2] - here
        along, aside = float(offset @ way), float(offset @ across)
        yaw = direction(pose) + np.pi / 2
        low = scene.TABLE_Z + 0.02
        if left < 0.016:
            return hand.move(np.array([*hand.position[:2], HIGH]), yaw, CLOSE, style.speed)
        behind = along < -0.025 and abs(aside) < 0.02
        if hand.position[2] < low + 0.012 and behind:
            target = here + way * (min(left, 0.05) - 0.02) - 1.5 * aside * across
            return hand.move(np.array([*target, low]), yaw, CLOSE, 0.6 * style.speed)
        start = here - 0.062 * way
        miss = float(np.hypot(*(hand.position[:2] - start)))
        above = min(style.approach, 4.0 * max(0.0, miss - 0.010))
        return hand.move(np.array([*start, low + above]), yaw, CLOSE, style.speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        left = np.hypot(*(block(achieved, self.index)[:2] - self.position))
        return bool(left < 0.03 and hand.position[2] > scene.TABLE_Z + 0.09)


@dataclass(frozen=True)
class Slide:
    """Take the drawer by its post and bring its opening to `opening` m."""

    name: str
    opening: float

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        now = float(achieved[DRAWER])
        post = np.array([scene.POST_XY[0], scene.POST_XY[1] - now, POST_GRIP_Z])
        off = float(np.hypot(*(hand.position - post)[:2]))
        level = abs(hand.position[2] - POST_GRIP_Z) < 0.015
        held = 0.010 < hand.opening < 0.034 and off < 0.02 and level
        left = self.opening - now
        if held and abs(left) > 0.006:
            ahead = np.array([0.0, left + np.sign(left) * 0.01, 0.0])
            return hand.move(post - ahead, REST_YAW, CLOSE, style.speed)
        if held or abs(left) <= 0.02:
            up = hand.position + _up(0.08 if hand.opening > 0.036 else 0.0)
            return hand.move(up, REST_YAW, OPEN, style.speed)
        turn = hand.yaw_error(REST_YAW)
        rise = 4.0 * max(0.0, off - 0.008) + 0.15 * max(0.0, turn - 0.12)
        target = post + _up(min(style.approach, rise))
        if hand.position[2] < target[2] - 0.02:
            target[:2] = hand.position[:2] + 0.2 * (target - hand.position)[:2]
        down = level and off < 0.014 and turn < 0.22
        return hand.move(target, REST_YAW, CLOSE if down else OPEN, style.speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        return bool(abs(achieved[DRAWER] - self.opening) <= 0.02 and hand.position[2] > POST_GRIP_Z + 0.05)


@dataclass(frozen=True)
class Press:
    """Press the button until the lamp is `lit` or not."""

    name: str
    lit: bool

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        x, y = scene.BUTTON_XY
        if (achieved[LAMP] > 0.5) == self.lit:
            leaving = 0.1 if hand.position[2] < scene.BUTTON_TOP + 0.02 else 1.0  # a button is let go slowly
            up = np.array([*hand.position[:2], HIGH])
            return hand.move(up, REST_YAW, CLOSE, leaving * style.speed)
        off = float(np.hypot(hand.position[0] - x, hand.position[1] - y))
        low = hand.position[2] < scene.BUTTON_TOP + 0.03
        above = min(style.approach, 4.0 * max(0.0, off - (0.020 if low else 0.010)))
        pressing = -0.04 if above == 0.0 and hand.opening < 0.02 else 0.02
        speed = style.speed * (0.5 if low else 1.0)
        return hand.move(np.array([x, y, scene.BUTTON_TOP + TIP + pressing + above]), REST_YAW, CLOSE, speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        return bool((achieved[LAMP] > 0.5) == self.lit and hand.position[2] > HIGH - 0.04)


@dataclass(frozen=True)
class Reach:
    """Move the empty gripper to `position` (3,) m, aimlessly as people do between two ideas."""

    name: str
    position: tuple[float, float, float]

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        return hand.move(np.array(self.position), REST_YAW, OPEN, style.speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        return bool(np.linalg.norm(hand.position - self.position) < 0.03)


def _clearance(place: Array, height: float) -> float:
    """Height above `place` at which to travel: the drawer's post and roof stand in the way of low flight."""
    return max(height, 0.12) if place[1] > 0.06 else height


def _up(height: float) -> Array:
    """(3,) `height` metres upwards."""
    return np.array([0.0, 0.0, height])
