"""The skills of PlayTable beside carrying: pushing a block, sliding the drawer, pressing the button."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.named import DRAWER, LAMP, block, direction, in_tray
from playlearn.teleop.hand import CLOSE, OPEN, REST_YAW, Hand, Style
from playlearn.teleop.skills import Waypoint, up, waypoint

HIGH = scene.TABLE_Z + 0.14
POST_GRIP_Z = scene.POST_TOP - 0.015
TIP = 0.005  # metres from the grip site down to where the fingers touch


@dataclass(frozen=True)
class Block:
    """A `Thing`: block `index`, gripped across its long side."""

    index: int
    symmetry: float = np.pi

    def position(self, achieved: Array) -> Array:
        return block(achieved, self.index)[:3].astype(float)

    def yaw(self, achieved: Array) -> float:
        return direction(block(achieved, self.index))

    def grasp(self, hand: Hand, achieved: Array) -> tuple[Array, float]:
        lift = 0.012 if in_tray(achieved, self.index) else 0.0  # the palm keeps clear of the tray's walls
        return self.position(achieved) + up(lift), self.yaw(achieved) + np.pi / 2

    def held(self, hand: Hand, achieved: Array) -> bool:
        off = hand.position - block(achieved, self.index)[:3]
        return bool(0.028 < hand.opening < 0.050 and np.hypot(*off[:2]) < 0.03 and abs(off[2]) < 0.03)

    def clearance(self, place: Array, height: float) -> float:
        """The drawer's post and roof stand in the way of low flight."""
        return max(height, 0.12) if place[1] > 0.06 else height


@dataclass(frozen=True)
class Push:
    """Push block `index` along the table to `position` (2,) m with closed fingers."""

    name: str
    index: int
    position: tuple[float, float]
    lasting: bool = True

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

    def plan(self, hand: Hand, achieved: Array, style: Style) -> Sequence[Waypoint]:
        pose = block(achieved, self.index)
        here, target = pose[:2].astype(float), np.array(self.position)
        way = (target - here) / max(float(np.linalg.norm(target - here)), 1e-6)
        yaw, low = direction(pose) + np.pi / 2, scene.TABLE_Z + 0.02
        start, end = np.array([*(here - 0.062 * way), low]), np.array([*(target - 0.03 * way), low])
        above, clear = start + up(style.approach), end + up(0.1)
        return tuple(waypoint(place, yaw, CLOSE) for place in (above, start, end, clear))


@dataclass(frozen=True)
class Slide:
    """Take the drawer by its post and bring its opening to `opening` m."""

    name: str
    opening: float
    lasting: bool = True

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
            away = hand.position + up(0.08 if hand.opening > 0.036 else 0.0)
            return hand.move(away, REST_YAW, OPEN, style.speed)
        turn = hand.yaw_error(REST_YAW)
        rise = 4.0 * max(0.0, off - 0.008) + 0.15 * max(0.0, turn - 0.12)
        target = post + up(min(style.approach, rise))
        if hand.position[2] < target[2] - 0.02:
            target[:2] = hand.position[:2] + 0.2 * (target - hand.position)[:2]
        down = level and off < 0.014 and turn < 0.22
        return hand.move(target, REST_YAW, CLOSE if down else OPEN, style.speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        return bool(abs(achieved[DRAWER] - self.opening) <= 0.02 and hand.position[2] > POST_GRIP_Z + 0.05)

    def plan(self, hand: Hand, achieved: Array, style: Style) -> Sequence[Waypoint]:
        post = np.array([scene.POST_XY[0], scene.POST_XY[1] - float(achieved[DRAWER]), POST_GRIP_Z])
        end = post - np.array([0.0, self.opening - float(achieved[DRAWER]), 0.0])
        return (
            waypoint(post + up(style.approach), REST_YAW, OPEN),
            waypoint(post, REST_YAW, CLOSE, wait=5),
            waypoint(end, REST_YAW, CLOSE),
            waypoint(end, REST_YAW, OPEN, wait=3),
            waypoint(end + up(0.08), REST_YAW, OPEN),
        )


@dataclass(frozen=True)
class Press:
    """Press the button until the lamp is `lit` or not."""

    name: str
    lit: bool
    lasting: bool = True

    def act(self, hand: Hand, achieved: Array, style: Style) -> Array:
        x, y = scene.BUTTON_XY
        if (achieved[LAMP] > 0.5) == self.lit:
            leaving = 0.1 if hand.position[2] < scene.BUTTON_TOP + 0.02 else 1.0  # a button is let go slowly
            away = np.array([*hand.position[:2], HIGH])
            return hand.move(away, REST_YAW, CLOSE, leaving * style.speed)
        off = float(np.hypot(hand.position[0] - x, hand.position[1] - y))
        low = hand.position[2] < scene.BUTTON_TOP + 0.03
        above = min(style.approach, 4.0 * max(0.0, off - (0.020 if low else 0.010)))
        pressing = -0.04 if above == 0.0 and hand.opening < 0.02 else 0.02
        speed = style.speed * (0.5 if low else 1.0)
        return hand.move(np.array([x, y, scene.BUTTON_TOP + TIP + pressing + above]), REST_YAW, CLOSE, speed)

    def done(self, hand: Hand, achieved: Array) -> bool:
        return bool((achieved[LAMP] > 0.5) == self.lit and hand.position[2] > HIGH - 0.04)

    def plan(self, hand: Hand, achieved: Array, style: Style) -> Sequence[Waypoint]:
        top = np.array([*scene.BUTTON_XY, scene.BUTTON_TOP + TIP])
        over = waypoint(top + up(style.approach), REST_YAW, CLOSE)
        return (over, waypoint(top - up(0.03), REST_YAW, CLOSE, wait=2), over)
