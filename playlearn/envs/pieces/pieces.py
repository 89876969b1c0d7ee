"""Pieces on a table: loose objects with x y z and a yaw, that can be laid, pushed, turned and stacked.

What Lift and Stack share, and any other scene of blocks: the achieved goal and when it is reached, named
tasks, random starts, and the skill library. Piece i has five numbers of `achieved`, meters unless noted:

    x y z    its center
    c s      (cos, sin)(fold * yaw), the same however often it is turned by a whole turn / fold
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array
from playlearn.oracles.end_effector import REST_YAW, EndEffector
from playlearn.oracles.skills import NEAR, NEAR_YAW, turn

PARTS = ("x", "y", "z", "c", "s")
POSITION_TOLERANCE, HEIGHT_TOLERANCE, YAW_TOLERANCE = 0.04, 0.02, np.deg2rad(20.0)  # meters, meters, radians
_FINGER = 0.02  # meters of room that a finger needs beside a piece


@dataclass(frozen=True)
class Table:
    """The table.

    z: meters, of its top.
    x, y: meters, the area in which pieces are laid.
    """

    z: float = 0.8
    x: tuple[float, float] = (-0.15, 0.15)
    y: tuple[float, float] = (-0.2, 0.2)

    def spots(self) -> Array:
        """(n, 2) a grid of places over the area, 7 cm or less apart."""
        x, y = (np.linspace(low, high, 1 + int(np.ceil((high - low) / 0.07))) for low, high in (self.x, self.y))
        grid: Array = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        return grid


@dataclass(frozen=True)
class Piece:
    """A `GraspableObject`.

    name: its body in the scene is `<name>_main`, its free joint `<name>_joint0`.
    index: of its five numbers in `achieved`.
    width: meters between the fingers.
    height: meters.
    fold: see the module's docstring.
    """

    name: str
    index: int
    width: float
    height: float
    fold: int = 4

    @property
    def symmetry(self) -> float:
        return 2 * np.pi / self.fold

    def position(self, achieved: Array) -> Array:
        return achieved[5 * self.index : 5 * self.index + 3].astype(float)

    def yaw(self, achieved: Array) -> float:
        c, s = achieved[5 * self.index + 3 : 5 * self.index + 5]
        return float(np.arctan2(s, c)) / self.fold

    def grasp(self, hand: EndEffector, achieved: Array) -> tuple[Array, float]:
        """Of the ways to take it, the one with room for the fingers, then the one that turns the gripper least."""
        here = self.position(achieved)
        others = np.delete(achieved.reshape(-1, 5)[:, :3], self.index, axis=0) - here
        others = others[np.abs(others[:, 2]) < self.height]

        def cost(yaw: float) -> float:
            finger = np.array([np.cos(yaw), np.sin(yaw)])
            along, aside = np.abs(others[:, :2] @ finger), np.abs(others[:, :2] @ np.array([-finger[1], finger[0]]))
            crowded = ((along < self.width + 2 * _FINGER) & (aside < self.width)).any()
            return abs(turn(REST_YAW, yaw, np.pi)) + 0.5 * hand.yaw_error(yaw) + 10.0 * bool(crowded)

        ways = self.yaw(achieved) + np.pi / 2 + np.arange(max(1, self.fold // 2)) * self.symmetry
        return here, float(min(ways, key=cost))

    def held(self, hand: EndEffector, achieved: Array) -> bool:
        off = hand.position - self.position(achieved)
        between = self.width - 0.012 < hand.opening < self.width + 0.006
        return bool(between and np.hypot(*off[:2]) < 0.03 and abs(off[2]) < 0.03)

    def clearance(self, place: Array, height: float) -> float:
        return height

    def encode(self, yaw: float) -> Array:
        """(2,) c, s of a yaw in rad."""
        return np.array([np.cos(self.fold * yaw), np.sin(self.fold * yaw)])


class Pieces:
    """The pieces of a scene, the table they are on, and what holds of `achieved` (5 * n,)."""

    def __init__(self, pieces: Sequence[Piece], table: Table) -> None:
        self.all, self.table = tuple(pieces), table
        self.names = tuple(f"{piece.name}.{part}" for piece in pieces for part in PARTS)

    def lying(self, achieved: Array, piece: Piece) -> bool:
        """Whether it lies on the table itself."""
        return bool(abs(piece.position(achieved)[2] - self.table.z - piece.height / 2) < 0.012)

    def supporter(self, achieved: Array, piece: Piece) -> Piece | None:
        """The piece that it rests on, if any."""
        for other in self.others(piece):
            off = piece.position(achieved) - other.position(achieved)
            if np.hypot(*off[:2]) < 0.03 and abs(off[2] - (piece.height + other.height) / 2) < 0.015:
                return other
        return None

    def rider(self, achieved: Array, piece: Piece) -> Piece | None:
        """The piece that rests on it, if any."""
        return next((other for other in self.others(piece) if self.supporter(achieved, other) == piece), None)

    def clear(self, achieved: Array, piece: Piece) -> bool:
        return self.rider(achieved, piece) is None

    def rests(self, achieved: Array, piece: Piece) -> bool:
        """Whether it would stay where it is, and is not in the air."""
        return self.lying(achieved, piece) or self.supporter(achieved, piece) is not None

    def others(self, piece: Piece) -> list[Piece]:
        return [other for other in self.all if other != piece]

    def around(self, achieved: Array, piece: Piece) -> Array:
        """(n - 1, 2) where the others are."""
        return np.array([other.position(achieved)[:2] for other in self.others(piece)]).reshape(-1, 2)

    def free_spot(self, taken: Array, rng: np.random.Generator, away: float = 0.09) -> Array:
        """(2,) a random place to lay a piece, `away` meters from all that is taken (n, 2)."""
        (x0, x1), (y0, y1) = self.table.x, self.table.y
        for _ in range(200):
            spot = rng.uniform((x0, y0), (x1, y1))
            if (np.hypot(*(taken - spot).T) > away).all():
                break
        return spot

    def there(self, achieved: Array, goal: Array, piece: Piece) -> bool:
        off = piece.position(achieved) - piece.position(goal)
        turned = turn(piece.yaw(achieved), piece.yaw(goal), piece.symmetry)
        return bool(np.hypot(*off[:2]) < NEAR and abs(off[2]) < 0.015 and abs(turned) < NEAR_YAW + 0.05)

    def reached(self, achieved: Array, goal: Array) -> bool:
        for piece in self.all:
            off = piece.position(achieved) - piece.position(goal)
            if np.hypot(*off[:2]) > POSITION_TOLERANCE or abs(off[2]) > HEIGHT_TOLERANCE:
                return False
            if abs(turn(piece.yaw(achieved), piece.yaw(goal), piece.symmetry)) > YAW_TOLERANCE:
                return False
        return True
