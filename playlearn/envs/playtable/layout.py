"""What `achieved` says of the table: its indices, and what can be read off them."""

import math

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.episode import Array

BLOCK_NAMES = tuple(scene.BLOCKS)
DRAWER, SLIDER, LEVER, LED, BULB = 15, 16, 17, 18, 19
ACHIEVED_NAMES = (
    *(f"{name}.{part}" for name in BLOCK_NAMES for part in ("x", "y", "z", "c", "s")),
    "drawer.opening",
    "slider.position",
    "lever.angle",
    "led.on",
    "bulb.on",
)
LYING_Z = scene.TABLE_Z + scene.BLOCK_HALF[2]
STOWED_Z = scene.TRAY_FLOOR + scene.BLOCK_HALF[2]
LANDING_Y = scene.EDGE_Y + 0.02  # where a block comes to lie that is pushed over the edge
FREE_X, FREE_Y = (-0.03, 0.15), (-0.18, 0.12)  # where blocks are laid, meters
OPEN, CLOSED = 0.11, 0.03  # meters of drawer opening
COVERING = 0.078  # meters along the bay between block and slider, below which no finger gets at the block


def block(achieved: Array, index: int) -> Array:
    """(5,) x, y, z, c, s of one block: a view."""
    return achieved[5 * index : 5 * index + 5]


def direction(pose: Array) -> float:
    """Yaw of a block's long axis in (-pi/2, pi/2] from its (c, s)."""
    return math.atan2(pose[4], pose[3]) / 2


def upright(pose: Array) -> bool:
    """Whether a block stands on its end, more or less."""
    return math.hypot(pose[3], pose[4]) < 0.5  # the squared cosine of its long axis's slope


def between(yaw: float, other: float) -> float:
    """How far two directions of long axes differ, rad in [-pi/2, pi/2): the turn from `other` to `yaw`."""
    return (yaw - other + math.pi / 2) % math.pi - math.pi / 2


def distance(pose: Array, other: Array | tuple[float, float]) -> float:
    """Meters between two places in the plane."""
    return math.hypot(pose[0] - other[0], pose[1] - other[1])


def others(index: int) -> list[int]:
    return [i for i in range(len(BLOCK_NAMES)) if i != index]


def in_tray(achieved: Array, index: int) -> bool:
    """Whether block `index` is in the drawer."""
    x, y, z = block(achieved, index)[:3]
    inside = abs(x - scene.TRAY_X) < scene.TRAY_HALF[0] and abs(y - tray_y(achieved)) < scene.TRAY_HALF[1]
    return bool(inside and z < scene.TABLE_Z + 0.012)


def in_bay(achieved: Array, index: int) -> bool:
    """Whether block `index` is where the slider runs."""
    x, y, z = block(achieved, index)[:3]
    (bx, by), (hx, hy) = scene.BAY_CENTER, scene.BAY_HALF
    return bool(abs(x - bx) < hx and abs(y - by) < hy and abs(z - LYING_Z) < 0.02)


def covered(achieved: Array, index: int) -> bool:
    """Whether the slider is over block `index`, or so near that fingers cannot get at it."""
    x, y, z = block(achieved, index)[:3]
    near = abs(y - slider_y(achieved)) < COVERING and x < scene.BAY_CENTER[0] + scene.SLIDER_HALF[0] + 0.03
    return bool(near and z < scene.SLIDER_ROOF + 0.02)


def on_table(achieved: Array, index: int) -> bool:
    """Whether block `index` lies flat on the deck, outside the bay."""
    pose = block(achieved, index)
    flat = abs(pose[2] - LYING_Z) < 0.012 and pose[1] < scene.EDGE_Y
    return bool(flat and not in_bay(achieved, index) and not in_tray(achieved, index))


def supporter(achieved: Array, index: int) -> int | None:
    """The block that block `index` rests on, if any."""
    pose = block(achieved, index)
    for other in others(index):
        under = block(achieved, other)
        if distance(pose, under) < 0.04 and abs(pose[2] - under[2] - 0.04) < 0.015:
            return other
    return None


def rider(achieved: Array, index: int) -> int | None:
    """The block that rests on block `index`, if any."""
    return next((other for other in others(index) if supporter(achieved, other) == index), None)


def clear(achieved: Array, index: int) -> bool:
    """Whether nothing rests on block `index`."""
    return rider(achieved, index) is None


def lies_free(achieved: Array, index: int) -> bool:
    """Whether block `index` lies flat on the deck, with nothing on it."""
    return on_table(achieved, index) and clear(achieved, index)


def bases(achieved: Array, index: int) -> list[int]:
    """The blocks that block `index` could be stacked on."""
    return [i for i in others(index) if lies_free(achieved, i)]


def tray_y(achieved: Array) -> float:
    """Where the tray's center is, y in meters."""
    return scene.TRAY_Y + float(achieved[DRAWER])


def slider_y(achieved: Array) -> float:
    """Where the slider's center is, y in meters."""
    return scene.SLIDER_Y + float(achieved[SLIDER])


def free_spot(taken: Array, rng: np.random.Generator, away: float = 0.09) -> Array:
    """(2,) a random place to lay a block, `away` meters from all `taken` (n, 2) if that can be had."""
    for _ in range(200):
        spot = rng.uniform((FREE_X[0], FREE_Y[0]), (FREE_X[1], FREE_Y[1]))
        if (np.hypot(*(taken - spot).T) > away).all():
            break
    return spot


def with_block(achieved: Array, index: int, xy: Array | tuple[float, float], z: float, yaw: float) -> Array:
    """A copy of `achieved` in which block `index` lies elsewhere."""
    goal = achieved.copy()
    block(goal, index)[:] = (xy[0], xy[1], z, math.cos(2 * yaw), math.sin(2 * yaw))
    return goal


def with_drawer(achieved: Array, opening: float) -> Array:
    """A copy of `achieved` with the drawer, and what lies in it, moved."""
    goal = achieved.copy()
    for index in range(len(BLOCK_NAMES)):
        if in_tray(achieved, index):
            block(goal, index)[1] += opening - achieved[DRAWER]
    goal[DRAWER] = opening
    return goal
