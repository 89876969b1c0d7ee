"""Where a gripper fits: beside which walls, posts and blocks its fingers and its palm can be let down."""

import math
from collections.abc import Sequence

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.layout import BLOCK_NAMES, block, direction, slider_y, tray_y, upright
from playlearn.episode import Array

ACROSS, ALONG = math.pi / 2, 0.0  # how the finger axis stands to a block's long axis
FINGER_OUT = 0.053  # meters from the grip site to the center of an open finger
FINGER = (0.0145, 0.0105)  # half its thickness (along the finger axis) and half its width
PALM = (0.104, 0.032)
FINGER_LOW, PALM_LOW = -0.009, 0.029  # meters from the grip site up to where they begin
Box = tuple[float, float, float, float, float]  # x, y, yaw, half its length, half its width
Obstacle = tuple[Box, float]  # and the z of its top
Place = Sequence[float] | Array  # (3,) m


def clearance(around: Sequence[Obstacle], grip: Place, finger_yaw: float) -> float:
    """Meters between an open gripper at `grip` and the nearest of the obstacles that are high enough to be met."""
    x, y, z = float(grip[0]), float(grip[1]), float(grip[2])
    dx, dy = FINGER_OUT * math.cos(finger_yaw), FINGER_OUT * math.sin(finger_yaw)
    fingers = (x + dx, y + dy, finger_yaw, *FINGER), (x - dx, y - dy, finger_yaw, *FINGER)
    palm = (x, y, finger_yaw, *PALM)
    least = math.inf
    for box, top in around:
        if math.hypot(box[0] - x, box[1] - y) - box[3] - box[4] > 0.11:
            continue
        if top > z + FINGER_LOW:
            least = min(least, apart(fingers[0], box), apart(fingers[1], box))
        if top > z + PALM_LOW:
            least = min(least, apart(palm, box))
    return least


def obstacles(achieved: Array, index: int) -> list[Obstacle]:
    """All that a gripper on block `index` could touch."""
    bay_x, bay_y = scene.BAY_CENTER
    slider, tray = slider_y(achieved), tray_y(achieved)
    r = scene.POST_RADIUS
    front = tray + scene.DRAWER_POST_XY[1] - scene.TRAY_Y
    return [
        *((footprint(achieved, i), top(achieved, i)) for i in range(len(BLOCK_NAMES)) if i != index),
        ((0.0, scene.EDGE_Y - 0.3, 0.0, 0.4, 0.3), scene.TABLE_Z - 0.002),
        ((scene.TRAY_X, front, 0.0, r, r), scene.DRAWER_POST_TOP),
        ((scene.RAIL_X, bay_y, 0.0, 0.005, scene.BAY_HALF[1]), scene.SLIDER_ROOF),
        ((bay_x, slider, 0.0, *scene.SLIDER_HALF), scene.SLIDER_ROOF + 0.008),
        ((bay_x, slider, 0.0, r, r), scene.SLIDER_POST_TOP),
        ((*scene.BUTTON_XY, 0.0, 0.036, 0.036), scene.BUTTON_TOP),
        ((*scene.LEVER_XY, 0.0, 0.015, 0.045), scene.LEVER_PIVOT + scene.LEVER_LENGTH),
    ]


def footprint(achieved: Array, index: int) -> Box:
    """A block from above."""
    pose = block(achieved, index)
    length, width, _ = scene.BLOCK_HALF
    return float(pose[0]), float(pose[1]), direction(pose), width if upright(pose) else length, width


def top(achieved: Array, index: int) -> float:
    """The z of a block's top."""
    pose = block(achieved, index)
    return float(pose[2]) + scene.BLOCK_HALF[0 if upright(pose) else 2]


def apart(one: Box, other: Box) -> float:
    """Meters by which two boxes are apart along the best separating side; negative where they overlap."""
    dx, dy = other[0] - one[0], other[1] - one[1]
    c, s = math.cos(one[2] - other[2]), math.sin(one[2] - other[2])
    c, s = abs(c), abs(s)
    best = -math.inf
    for (_, _, yaw, length, width), (_, _, _, far, near) in ((one, other), (other, one)):
        ux, uy = math.cos(yaw), math.sin(yaw)
        best = max(
            best,
            abs(dx * ux + dy * uy) - length - far * c - near * s,
            abs(dy * ux - dx * uy) - width - far * s - near * c,
        )
    return best


def spots() -> Array:
    """(n, 2) places on the deck at which a block may be laid aside."""
    x, y = np.meshgrid(np.linspace(-0.02, 0.14, 5), np.linspace(-0.17, 0.11, 8))
    return np.stack([x.ravel(), y.ravel()], axis=1)
