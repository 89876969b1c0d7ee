"""A robosuite scene of pieces behind the Environment contract."""

from typing import Any

import numpy as np

from playlearn.envs.pieces.pieces import Piece, Pieces
from playlearn.envs.pieces.tasks import piece_tasks
from playlearn.envs.tabletop import TabletopConfig, TabletopEnv, View, upright
from playlearn.episode import Array

_VIEW = View(eye=(0.72, 0.0, 1.45), at=(-0.01, 0.0, 0.84), fovy=30)


class PiecesEnv(TabletopEnv):
    """A robosuite scene of pieces.

    name: what robosuite has registered it as; `options` go to its constructor.
    pieces: with the table they lie on.
    beyond: fraction of random starts in which pieces lie anywhere on the area, not where robosuite lays them.
    stacked: fraction in which one is on another.
    view: of the front camera.
    """

    def __init__(
        self,
        config: TabletopConfig,
        name: str,
        pieces: Pieces,
        *,
        beyond: float = 0.5,
        stacked: float = 0.0,
        view: View = _VIEW,
        **options: Any,
    ) -> None:
        super().__init__(config, name, pieces.names, view, **options)
        self.pieces, self._beyond, self._stacked = pieces, beyond, stacked
        self.tasks = piece_tasks(pieces)
        self._bodies = [self.body(f"{piece.name}_main") for piece in pieces.all]

    def _achieved(self) -> Array:
        value = np.empty(len(self.pieces.names), np.float32)
        for i, (body, piece) in enumerate(zip(self._bodies, self.pieces.all, strict=True)):
            value[5 * i : 5 * i + 3] = self.data.xpos[body]
            value[5 * i + 3 : 5 * i + 5] = yaw_code(self.data.xmat[body].reshape(3, 3), piece.fold)
        return value

    def failure(self) -> str | None:
        for body, piece in zip(self._bodies, self.pieces.all, strict=True):
            if self.data.xpos[body, 2] < self.pieces.table.z - 0.03:
                return f"the {piece.name} fell off the table"
        return None

    def reached(self, achieved: Array, goal: Array) -> bool:
        return self.pieces.reached(achieved, goal)

    def _arrange(self, rng: np.random.Generator) -> None:
        super()._arrange(rng)
        draw, pieces = rng.random(), self.pieces.all
        if draw < self._beyond:
            taken = np.full((len(pieces), 2), 9.0)
            for i in rng.permutation(len(pieces)):
                taken[i] = self.pieces.free_spot(np.delete(taken, i, 0), rng)
                self.lay(pieces[i], taken[i], rng.uniform(-np.pi, np.pi))
        elif draw < self._beyond + self._stacked:
            top, below = rng.permutation(len(pieces))[:2]
            self.stack(pieces[top], pieces[below], rng)

    def lay(self, piece: Piece, xy: Array, yaw: float, z: float | None = None) -> None:
        """Put a piece flat on the table, or with its underside at z m; for start states only."""
        bottom = self.pieces.table.z if z is None else z
        self.put(f"{piece.name}_joint0", [*xy, bottom + piece.height / 2 + 0.001], upright(yaw))

    def stack(self, top: Piece, below: Piece, rng: np.random.Generator) -> None:
        """Put one piece on another; for start states only."""
        self._refresh()
        achieved = self._achieved()
        under = below.position(achieved)
        yaw = below.yaw(achieved) + rng.uniform(-0.3, 0.3)
        self.lay(top, under[:2] + rng.uniform(-0.006, 0.006, 2), yaw, self.pieces.table.z + below.height)


def yaw_code(rotation: Array, fold: int) -> Array:
    """(2,) c, s of a body's rotation (3, 3): (cos, sin)(fold * yaw), however it lies.

    fold 4 is a cube's: all three axes count, and the sum of their fourth powers (as complex numbers in the plane)
    does not know which of them is up. Otherwise the body's x axis is what points.
    """
    axes = rotation[0] + 1j * rotation[1]  # (3,) each body axis, in the plane
    code = 0.5 * (axes**4).sum() if fold == 4 else axes[0] ** fold
    return np.array([code.real, code.imag])
