"""How a block is gripped: across its long side where the gripper fits there, else along it."""

import math
from dataclasses import dataclass

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.fit import ACROSS, ALONG, clearance, obstacles
from playlearn.envs.playtable.layout import block, direction, upright
from playlearn.episode import Array
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skills import up

_WIDTHS = {ACROSS: (0.028, 0.050), ALONG: (0.060, 0.0745)}  # meters between the pads while a block is held


@dataclass(frozen=True)
class Block:
    """A `GraspableObject`.

    index: of the block.
    to: where it is going ((3,) m and yaw), if that matters to how it is gripped.
    over: z in meters above which it is carried.
    symmetry: rad.
    """

    index: int
    to: tuple[float, float, float, float] | None = None
    over: float = 0.0
    symmetry: float = np.pi

    def position(self, achieved: Array) -> Array:
        return block(achieved, self.index)[:3].astype(float)

    def yaw(self, achieved: Array) -> float:
        return direction(block(achieved, self.index))

    def grasp(self, hand: EndEffector, achieved: Array) -> tuple[Array, float]:
        pose = block(achieved, self.index)
        grip = self.position(achieved) + up(lift(pose[1], pose[2], upright(pose)))
        return grip, direction(pose) + self.way(hand, achieved)

    def way(self, hand: EndEffector, achieved: Array) -> float:
        """Across or along: as it is gripped already, else as there is room here, and there."""
        held = gripped(hand, achieved, self.index)
        if held is not None:
            return held
        pose = block(achieved, self.index)
        if upright(pose):
            return ACROSS
        x, y, z = map(float, pose[:3])
        here = ways(achieved, self.index, (x, y, z, direction(pose)))
        there = here if self.to is None or len(here) < 2 else ways(achieved, self.index, self.to)
        good = [way for way in here if way in there] or [*here] or [ACROSS]
        if len(good) > 1 and hand.yaw_error(direction(pose) + good[1]) < 0.3:  # it is turned that way already
            off = hand.position - pose[:3]
            return good[1] if math.hypot(off[0], off[1]) < 0.015 and off[2] < 0.05 else good[0]
        return good[0]

    def held(self, hand: EndEffector, achieved: Array) -> bool:
        return gripped(hand, achieved, self.index) is not None

    def clearance(self, place: Array, height: float) -> float:
        """The posts stand in the way of low flight, and blocks on blocks."""
        x, y, z = map(float, place)
        fixtures = 0.135 if x < -0.08 else 0.11 if y > 0.12 or y < -0.2 else 0.0
        return max(height, scene.TABLE_Z + fixtures - z, self.over - z)


def lift(y: float, z: float, standing: bool = False) -> float:
    """Meters above its center at which a block there is gripped: high, where the palm would meet the deck."""
    return 0.013 if standing or (z < scene.TABLE_Z and y > scene.EDGE_Y - 0.05) else 0.010


def ways(achieved: Array, index: int, pose: tuple[float, float, float, float]) -> tuple[float, ...]:
    """How block `index` could be taken, or let go, were it at `pose` ((3,) m and yaw)."""
    x, y, z, yaw = pose
    around, grip = obstacles(achieved, index), (x, y, z + lift(y, z))
    return tuple(way for way in (ACROSS, ALONG) if clearance(around, grip, yaw + way) > 0.0)


def gripped(hand: EndEffector, achieved: Array, index: int) -> float | None:
    """How block `index` is between the fingers: ACROSS or ALONG; None where it is not."""
    pose = block(achieved, index)
    off = hand.position - pose[:3]
    if math.hypot(off[0], off[1]) > 0.03 or not -0.03 < off[2] < 0.032:
        return None
    for way, (least, most) in _WIDTHS.items():
        turned = hand.yaw_error(direction(pose) + way)
        if least < hand.opening < most and (turned < 0.6 or upright(pose)):
            return way
    return None
