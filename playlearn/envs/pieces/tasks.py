"""The named tasks of pieces: where each starts, its goal, and its success test."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.envs.pieces.pieces import POSITION_TOLERANCE, YAW_TOLERANCE, Piece, Pieces
from playlearn.episode import Array
from playlearn.oracles.skills import turn
from playlearn.sim.environment import Task

LIFTED = 0.04  # meters above the table at which robosuite's Lift calls its cube lifted


def piece_tasks(pieces: Pieces) -> Mapping[str, Task]:
    """Name -> task, in the order that reports use."""
    tasks = [task for piece in pieces.all for task in PieceTasks(pieces, piece).tasks()]
    return MappingProxyType({task.name: task for task in tasks})


@dataclass(frozen=True)
class PieceTasks:
    """The tasks of one piece."""

    pieces: Pieces
    piece: Piece

    def tasks(self) -> tuple[Task, ...]:
        name = self.piece.name
        alone = (
            Task(f"lift_{name}", "lift", self.lying, _as_it_comes, self.lift, self.lifted),
            Task(f"push_{name}", "push", self.lying, _as_it_comes, self.push, self.at_goal),
            Task(f"rotate_{name}", "rotate", self.lying, _as_it_comes, self.rotate, self.turned),
            Task(f"place_{name}", "place", self.lying, _as_it_comes, self.place, self.at_goal),
        )
        if len(self.pieces.all) < 2:
            return alone
        return (
            *alone,
            Task(f"stack_{name}", "stack", self.can_stack, _as_it_comes, self.stack, self.stacked),
            Task(f"unstack_{name}", "unstack", self.on_top, self.pile, self.place, self.unstacked),
        )

    # Where a task can start -------------------------------------------------------------------------

    def lying(self, achieved: Array) -> bool:
        return self.pieces.lying(achieved, self.piece) and self.pieces.clear(achieved, self.piece)

    def can_stack(self, achieved: Array) -> bool:
        return self.lying(achieved) and bool(self.bases(achieved))

    def on_top(self, achieved: Array) -> bool:
        above = self.pieces.supporter(achieved, self.piece) is not None
        return above and self.pieces.clear(achieved, self.piece)

    def pile(self, env: Any, rng: np.random.Generator) -> None:
        others = self.pieces.others(self.piece)
        env.stack(self.piece, others[int(rng.integers(len(others)))], rng)
        env.refresh()

    # Its goal ---------------------------------------------------------------------------------------

    def lift(self, achieved: Array, rng: np.random.Generator) -> Array:
        return self._moved(achieved, z=self.piece.position(achieved)[2] + rng.uniform(0.09, 0.13))

    def push(self, achieved: Array, rng: np.random.Generator) -> Array:
        """Square to one of its sides, as far as there is room; the goal is `achieved` itself where there is none."""
        here, rest = self.piece.position(achieved)[:2], self.pieces.around(achieved, self.piece)
        table = self.pieces.table
        for _ in range(50):
            along = self.piece.yaw(achieved) + rng.integers(4) * np.pi / 2
            spot = here + rng.uniform(0.06, 0.10) * np.array([np.cos(along), np.sin(along)])
            inside = table.x[0] <= spot[0] <= table.x[1] and table.y[0] <= spot[1] <= table.y[1]
            if inside and (np.hypot(*(rest - spot).T) > 0.09).all():
                return self._moved(achieved, xy=spot)
        return achieved.copy()

    def rotate(self, achieved: Array, rng: np.random.Generator) -> Array:
        most = min(1.2, 0.9 * self.piece.symmetry / 2)
        return self._moved(achieved, yaw=self.piece.yaw(achieved) + rng.choice([-1, 1]) * rng.uniform(0.5, most))

    def place(self, achieved: Array, rng: np.random.Generator) -> Array:
        """Lying on the table, at least 10 cm from where it is now."""
        here, rest = self.piece.position(achieved)[:2], self.pieces.around(achieved, self.piece)
        for _ in range(100):
            spot = self.pieces.free_spot(rest, rng)
            if np.hypot(*(spot - here)) > 0.10:
                break
        return self._moved(achieved, xy=spot, z=self.pieces.table.z + self.piece.height / 2)

    def stack(self, achieved: Array, rng: np.random.Generator) -> Array:
        bases = self.bases(achieved) or self.pieces.others(self.piece)
        under = bases[int(rng.integers(len(bases)))]
        x, y, z = under.position(achieved)
        return self._moved(achieved, (x, y), z + (under.height + self.piece.height) / 2, under.yaw(achieved))

    # When it is solved -------------------------------------------------------------------------------

    def at_goal(self, start: Array, achieved: Array, goal: Array) -> bool:
        return self._distance(achieved, goal) < POSITION_TOLERANCE and self.pieces.lying(achieved, self.piece)

    def turned(self, start: Array, achieved: Array, goal: Array) -> bool:
        off = turn(self.piece.yaw(achieved), self.piece.yaw(goal), self.piece.symmetry)
        lies = self.pieces.lying(achieved, self.piece)
        return bool(lies and abs(off) < YAW_TOLERANCE and self._distance(achieved, goal) < 0.05)

    def lifted(self, start: Array, achieved: Array, goal: Array) -> bool:
        return bool(self.piece.position(achieved)[2] > self.pieces.table.z + LIFTED)

    def stacked(self, start: Array, achieved: Array, goal: Array) -> bool:
        base = self.pieces.supporter(achieved, self.piece)
        return base is not None and base == self.pieces.supporter(goal, self.piece)

    def unstacked(self, start: Array, achieved: Array, goal: Array) -> bool:
        return self.pieces.lying(achieved, self.piece)

    def bases(self, achieved: Array) -> list[Piece]:
        """The pieces that this one could be stacked on."""
        pieces = self.pieces
        return [p for p in pieces.others(self.piece) if pieces.clear(achieved, p) and pieces.lying(achieved, p)]

    def _distance(self, achieved: Array, goal: Array) -> float:
        return float(np.hypot(*(self.piece.position(achieved) - self.piece.position(goal))[:2]))

    def _moved(self, achieved: Array, xy: Any = None, z: float | None = None, yaw: float | None = None) -> Array:
        goal, start = achieved.copy(), 5 * self.piece.index
        if xy is not None:
            goal[start : start + 2] = xy
        if z is not None:
            goal[start + 2] = z
        if yaw is not None:
            goal[start + 3 : start + 5] = self.piece.encode(yaw)
        return goal


def _as_it_comes(env: Any, rng: np.random.Generator) -> None:
    """Nothing to bring about: most random starts suit."""
