"""Where the fingers of a gripper fit: beside which walls, edges and blocks they can be let down."""

import math
from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.layout import BLOCK_NAMES, block, direction, slider_y, upright

ACROSS, ALONG = math.pi / 2, 0.0  # how the finger axis stands to a block's long axis
FINGER = (0.053, 0.0145, 0.0105)  # of an open finger: its centre from the grip site, half its thickness and its width
Place = Sequence[float] | Array  # (3,) m
Box = tuple[float, float, float, float, float]  # x, y, yaw, half its length, half its width


def fits(achieved: Array, index: int, place: Place, finger_yaw: float) -> bool:
    """Whether open fingers around block `index`, were it at `place`, touch nothing else."""
    walls = obstacles(achieved, index, place)
    return not any(_overlap(finger, wall) for finger in fingers(place, finger_yaw) for wall in walls)


def fingers(place: Place, yaw: float) -> tuple[Box, Box]:
    """The two open fingers from above."""
    out, thick, wide = FINGER
    dx, dy = out * math.cos(yaw), out * math.sin(yaw)
    x, y = float(place[0]), float(place[1])
    return (x + dx, y + dy, yaw, thick, wide), (x - dx, y - dy, yaw, thick, wide)


def obstacles(achieved: Array, index: int, place: Place) -> list[Box]:
    """All that stands in the way of fingers that grip block `index` at `place` (3,) m."""
    z = place[2]
    walls = [
        footprint(achieved, i) for i in range(len(BLOCK_NAMES)) if i != index and abs(block(achieved, i)[2] - z) < 0.045
    ]
    if z < scene.TABLE_Z + 0.005 and place[1] > scene.EDGE_Y - 0.05:
        walls.append((0.0, scene.EDGE_Y - 0.2, 0.0, 0.3, 0.2))
    if z < scene.SLIDER_ROOF + 0.01 and place[0] < scene.BAY_CENTRE[0] + 0.12:
        x, y = scene.BAY_CENTRE
        walls.append((scene.RAIL_X, y, 0.0, 0.005, scene.BAY_HALF[1]))
        walls.append((x, slider_y(achieved), 0.0, *scene.SLIDER_HALF))
    if place[1] < -0.18:
        walls.append((*scene.BUTTON_XY, 0.0, 0.036, 0.036))
        walls.append((*scene.LEVER_XY, 0.0, 0.015, 0.045))
    return walls


def footprint(achieved: Array, index: int) -> Box:
    """A block from above."""
    pose = block(achieved, index)
    length, width, _ = scene.BLOCK_HALF
    return float(pose[0]), float(pose[1]), direction(pose), width if upright(pose) else length, width


def apart(one: Box, other: Box) -> float:
    """Metres by which two boxes are apart along the best separating side; negative where they overlap."""
    best = -math.inf
    between = (other[0] - one[0], other[1] - one[1])
    for yaw in (one[2], other[2]):
        for ux, uy in ((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))):
            gap = abs(between[0] * ux + between[1] * uy) - _extent(one, ux, uy) - _extent(other, ux, uy)
            best = max(best, gap)
    return best


def _overlap(one: Box, other: Box) -> bool:
    return apart(one, other) < 0.0


def _extent(box: Box, ux: float, uy: float) -> float:
    _, _, yaw, length, width = box
    c, s = math.cos(yaw), math.sin(yaw)
    return length * abs(c * ux + s * uy) + width * abs(c * uy - s * ux)


def spots() -> Array:
    """(n, 2) places on the deck at which a block may be laid aside."""
    x, y = np.meshgrid(np.linspace(-0.02, 0.14, 5), np.linspace(-0.17, 0.11, 8))
    return np.stack([x.ravel(), y.ravel()], axis=1)
