"""The skills of PlayTable beside carrying: sliding a fixture by its post, pressing, flipping, pushing over the edge."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.layout import (
    BULB,
    DRAWER,
    LED,
    LEVER,
    SLIDER,
    block,
    in_tray,
    others,
    upright,
)
from playlearn.episode import Array
from playlearn.oracles.end_effector import CLOSE, OPEN, REST_YAW, EndEffector, Style
from playlearn.oracles.skills import Waypoint, up, waypoint

HIGH = scene.TABLE_Z + 0.16
TIP = 0.009  # meters from the grip site down to where the fingers end


@dataclass(frozen=True)
class Post:
    """The post of a fixture that slides along y.

    index: of the fixture in `achieved`, 0 .. travel.
    xy: (2,) m, where the post stands at 0.
    grip_z: meters at which it is gripped.
    travel: meters.
    """

    index: int
    xy: tuple[float, float]
    grip_z: float
    travel: float

    def at(self, value: float) -> Array:
        """(3,) m, where to grip it."""
        return np.array([self.xy[0], self.xy[1] + value, self.grip_z])


POSTS = {
    DRAWER: Post(DRAWER, scene.DRAWER_POST_XY, scene.DRAWER_POST_TOP - 0.014, scene.DRAWER_TRAVEL),
    SLIDER: Post(SLIDER, (scene.BAY_CENTER[0], scene.SLIDER_Y), scene.SLIDER_POST_TOP - 0.015, scene.SLIDER_TRAVEL),
}


@dataclass(frozen=True)
class Slide:
    """Take a fixture by its post and bring it to `value` m. near: meters within which it is there."""

    name: str
    post: Post
    value: float
    near: float = 0.02
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        now = float(achieved[self.post.index])
        post = self.post.at(now)
        off, level, held = self._grip(hand, post)
        left = self.value - now
        if held and abs(left) > 0.006:
            return hand.move(post + np.array([0.0, left + np.sign(left) * 0.01, 0.0]), REST_YAW, CLOSE, style.speed)
        if held or abs(left) <= self.near:
            away = hand.position + up(0.08 if hand.opening > 0.032 else 0.0)
            if off < 0.03:  # straight up, wherever the arm may drift
                away[:2] = post[:2]
            return hand.move(away, REST_YAW, OPEN, style.speed)
        turn = hand.yaw_error(REST_YAW)
        rise = 4.0 * max(0.0, off - 0.008) + 0.15 * max(0.0, turn - 0.12)
        target = post + up(min(max(style.approach, scene.TABLE_Z + 0.13 - post[2]), rise))
        if hand.position[2] < target[2] - 0.02:
            target[:2] = hand.position[:2] + 0.2 * (target - hand.position)[:2]
        down = level and off < 0.014 and turn < 0.22
        return hand.move(target, REST_YAW, CLOSE if down else OPEN, style.speed)

    def underway(self, hand: EndEffector, achieved: Array) -> bool:
        """Whether it has begun and is not there yet."""
        now = float(achieved[self.post.index])
        return self._grip(hand, self.post.at(now))[2] and abs(self.value - now) > 0.010

    @staticmethod
    def _grip(hand: EndEffector, post: Array) -> tuple[float, bool, bool]:
        """Meters from the gripper to the post, whether it is at its height, and whether it holds it."""
        off = float(np.hypot(*(hand.position - post)[:2]))
        level = bool(abs(hand.position[2] - post[2]) < 0.015)
        return off, level, 0.018 < hand.opening < 0.028 and off < 0.02 and level

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        near = abs(achieved[self.post.index] - self.value) <= self.near
        return bool(near and hand.position[2] > self.post.grip_z + 0.05)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        post, end = self.post.at(float(achieved[self.post.index])), self.post.at(self.value)
        return (
            waypoint(post + up(style.approach), REST_YAW, OPEN),
            waypoint(post, REST_YAW, CLOSE, wait=5),
            waypoint(end, REST_YAW, CLOSE),
            waypoint(end, REST_YAW, OPEN, wait=3),
            waypoint(end + up(0.08), REST_YAW, OPEN),
        )


@dataclass(frozen=True)
class Withdraw:
    """Open the fingers and take them straight up from what is between them at (x, y) m."""

    name: str
    over: tuple[float, float]
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        rise = 0.08 if hand.opening > 0.032 else 0.0
        return hand.move(np.array([*self.over, hand.position[2] + rise]), hand.yaw, OPEN, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return bool(hand.position[2] > HIGH)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        here = waypoint(hand.position, hand.yaw, OPEN, wait=4)
        return here, waypoint(hand.position + up(0.08), hand.yaw, OPEN)


@dataclass(frozen=True)
class Press:
    """Press the button until the LED is `lit` or not."""

    name: str
    lit: bool
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        x, y = scene.BUTTON_XY
        if (achieved[LED] > 0.5) == self.lit:
            leaving = 0.1 if hand.position[2] < scene.BUTTON_TOP + 0.02 else 1.0  # a button is let go slowly
            away = np.array([*hand.position[:2], HIGH])
            return hand.move(away, REST_YAW, CLOSE, leaving * style.speed)
        off = float(np.hypot(hand.position[0] - x, hand.position[1] - y))
        if off < 0.03 and hand.position[2] < scene.BUTTON_TOP + 0.02:
            # Pressed down without a change: it was pressed before, and must come up first. That the fingers
            # are opened meanwhile tells the way up from the way down.
            if hand.opening > 0.004:
                return hand.move(np.array([x, y, hand.position[2] + 0.04]), REST_YAW, OPEN, style.speed)
            if hand.position[2] < scene.BUTTON_TOP + TIP - 0.009:
                return hand.move(hand.position, REST_YAW, OPEN, style.speed)
        low = hand.position[2] < scene.BUTTON_TOP + 0.03
        above = min(style.approach, 4.0 * max(0.0, off - (0.020 if low else 0.010)))
        pressing = -0.04 if above == 0.0 and hand.opening < 0.02 else 0.02
        speed = style.speed * (0.5 if low else 1.0)
        return hand.move(np.array([x, y, scene.BUTTON_TOP + 0.005 + pressing + above]), REST_YAW, CLOSE, speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return bool((achieved[LED] > 0.5) == self.lit and hand.position[2] > HIGH - 0.06)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        top = np.array([*scene.BUTTON_XY, scene.BUTTON_TOP + 0.005])
        over = waypoint(top + up(style.approach), REST_YAW, CLOSE)
        return (over, waypoint(top - up(0.03), REST_YAW, CLOSE, wait=2), over)


@dataclass(frozen=True)
class Flip:
    """Push the lever's knob across its middle with closed fingers: to the left, where the bulb is lit, or back."""

    name: str
    lit: bool
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        x, _ = scene.LEVER_XY
        side = -1.0 if self.lit else 1.0  # of the knob, on which the gripper comes down
        if self._over(achieved):
            low = hand.position[2] < _FLIP_Z + 0.03
            away = np.array([hand.position[0], hand.position[1] + (0.03 * side if low else 0.0), HIGH])
            return hand.move(away, REST_YAW, CLOSE, style.speed)
        knob = self._knob(achieved)
        beside = side * (hand.position[1] - knob)
        low = hand.position[2] < _FLIP_Z + 0.02
        if low and beside > 0.025 and abs(hand.position[0] - x) < 0.025:
            return hand.move(np.array([x, hand.position[1] - 0.03 * side, _FLIP_Z]), REST_YAW, CLOSE, 0.7 * style.speed)
        start = np.array([x, knob + 0.065 * side])
        miss = float(np.hypot(*(hand.position[:2] - start)))
        above = min(max(style.approach, 0.06), 4.0 * max(0.0, miss - 0.012)) + (0.05 if hand.opening > 0.02 else 0.0)
        target = np.array([*start, _FLIP_Z + above])
        if hand.position[2] < target[2] - 0.02:
            target[:2] = hand.position[:2] + 0.2 * (target - hand.position)[:2]
        return hand.move(target, REST_YAW, CLOSE, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return bool(self._over(achieved) and hand.position[2] > HIGH - 0.06)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        side = -1.0 if self.lit else 1.0
        x, y = scene.LEVER_XY
        start = np.array([x, self._knob(achieved) + 0.065 * side, _FLIP_Z])
        end = np.array([x, y + 0.03 * side, _FLIP_Z])
        stops = (start + up(style.approach), start, end, end + up(0.08))
        return tuple(waypoint(place, REST_YAW, CLOSE) for place in stops)

    def _over(self, achieved: Array) -> bool:
        return bool((achieved[BULB] > 0.5) == self.lit and abs(achieved[LEVER]) > 0.6 * scene.LEVER_RANGE)

    def _knob(self, achieved: Array) -> float:
        return scene.LEVER_XY[1] + scene.LEVER_LENGTH * math.sin(achieved[LEVER])


_FLIP_Z = scene.TABLE_Z + 0.074  # low enough to meet the knob, high enough for the palm to pass over it


@dataclass(frozen=True)
class PushIn:
    """Push block `index` over the deck's edge into the open drawer, with closed fingers."""

    name: str
    index: int
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        x, y = block(achieved, self.index)[:2].astype(float)
        low = scene.TABLE_Z + 0.02
        if in_tray(achieved, self.index):
            return hand.move(np.array([*hand.position[:2], HIGH]), REST_YAW, CLOSE, style.speed)
        behind = y - hand.position[1]
        if hand.position[2] < low + 0.015 and behind > 0.02 and abs(hand.position[0] - x) < 0.02:
            target = np.array([x, min(y + 0.02, scene.EDGE_Y + 0.01), low])
            return hand.move(target, 0.0, CLOSE, 0.6 * style.speed)
        start = np.array([x, y - 0.055])
        miss = float(np.hypot(*(hand.position[:2] - start)))
        turn = hand.yaw_error(0.0)
        above = min(style.approach, 4.0 * max(0.0, miss - 0.010) + 0.1 * max(0.0, turn - 0.15))
        return hand.move(np.array([*start, low + above]), 0.0, CLOSE, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        return in_tray(achieved, self.index) and bool(hand.position[2] > scene.TABLE_Z + 0.08)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        x, y, _ = block(achieved, self.index)[:3].astype(float)
        start, end = np.array([x, y - 0.055, scene.TABLE_Z + 0.02]), np.array([x, scene.EDGE_Y, scene.TABLE_Z + 0.02])
        stops = (start + up(style.approach), start, end, end + up(0.1))
        return tuple(waypoint(place, 0.0, CLOSE) for place in stops)


@dataclass(frozen=True)
class Tip:
    """Knock over a block that stands on its end, towards the middle of what it stands on."""

    name: str
    index: int
    lasting: bool = True

    def act(self, hand: EndEffector, achieved: Array, style: Style) -> Array:
        x, y, z = block(achieved, self.index)[:3].astype(float)
        if not upright(block(achieved, self.index)):
            return hand.move(hand.position + up(0.08), REST_YAW, CLOSE, style.speed)
        way = self._way(achieved)
        high = z + 0.022
        yaw = math.atan2(way[1], way[0]) + np.pi / 2
        behind = float((np.array([x, y]) - hand.position[:2]) @ way)
        aside = float(abs((np.array([x, y]) - hand.position[:2]) @ np.array([-way[1], way[0]])))
        if abs(hand.position[2] - high) < 0.02 and 0.0 < behind < 0.08 and aside < 0.015:
            return hand.move(np.array([*(np.array([x, y]) + 0.03 * way), high]), yaw, CLOSE, 0.6 * style.speed)
        start = np.array([x, y]) - 0.055 * way
        miss = float(np.hypot(*(hand.position[:2] - start)))
        above = min(0.08, 4.0 * max(0.0, miss - 0.010) + 0.1 * max(0.0, hand.yaw_error(yaw) - 0.15))
        target = np.array([*start, high + above])
        if hand.position[2] < target[2] - 0.02:
            target[:2] = hand.position[:2] + 0.2 * (target - hand.position)[:2]
        return hand.move(target, yaw, CLOSE, style.speed)

    def done(self, hand: EndEffector, achieved: Array) -> bool:
        pose = block(achieved, self.index)
        return not upright(pose) and bool(hand.position[2] > pose[2] + 0.08)

    def plan(self, hand: EndEffector, achieved: Array, style: Style) -> Sequence[Waypoint]:
        here = block(achieved, self.index)[:3].astype(float) + up(0.022)
        way = np.array([*self._way(achieved), 0.0])
        yaw = math.atan2(way[1], way[0]) + np.pi / 2
        stops = (here - 0.055 * way + up(0.08), here - 0.055 * way, here + 0.02 * way, here + 0.02 * way + up(0.08))
        return tuple(waypoint(place, yaw, CLOSE) for place in stops)

    def _way(self, achieved: Array) -> Array:
        """(2,) the unit vector along which it is to fall: away from its neighbors and from edges."""
        x, y = block(achieved, self.index)[:2].astype(float)
        if in_tray(achieved, self.index):
            return np.array([1.0 if x < scene.TRAY_X else -1.0, 0.0])
        rest = [block(achieved, i)[:2] for i in others(self.index)]

        def room(way: tuple[float, float]) -> float:
            fx, fy = x + 0.055 * way[0], y + 0.055 * way[1]
            inside = -0.10 * math.hypot(fx - 0.05, fy + 0.03)
            return min(0.1, *(math.hypot(fx - other[0], fy - other[1]) for other in rest)) + inside

        return np.array(max(((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)), key=room))
