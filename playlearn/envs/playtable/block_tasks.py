"""The named tasks that name their block: to turn it, to push it, to take it up."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.layout import (
    DRAWER,
    FREE_X,
    FREE_Y,
    OPEN,
    between,
    block,
    clear,
    covered,
    direction,
    distance,
    free_spot,
    in_bay,
    in_tray,
    lies_free,
    on_table,
    others,
    with_block,
)
from playlearn.episode import Array
from playlearn.sim.environment import Task

LEFT, RIGHT = 1, -1
NEAR = 0.04  # meters from where the goal shows it
DRAWS = 10  # in which a block is laid down so that a task can begin
_REACH, _LEAST = 0.10, 0.07  # meters over which a block is pushed: at most and at least
_TURN = (0.7, 1.2)  # radians by which a block is turned
_FURTHEST = 1.3  # radians of yaw, beyond which the wrist would have to turn around


@dataclass(frozen=True)
class BlockTasks:
    """The tasks that name this block."""

    index: int
    name: str

    def rotate(self, side: str, sign: int) -> Task:
        """Turned that way, where it lies."""
        index = self.index

        def suits(achieved: Array) -> bool:
            return self.lying(achieved) and sign * direction(block(achieved, index)) + _TURN[0] < _FURTHEST

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            x, y, z = block(achieved, index)[:3]
            yaw = direction(block(achieved, index))
            turn = rng.uniform(_TURN[0], max(_TURN[0], min(_TURN[1], _FURTHEST - sign * yaw)))
            return with_block(achieved, index, (x, y), z, yaw + sign * turn)

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            before, now, wanted = (block(a, index) for a in (start, achieved, goal))
            turned = sign * between(direction(now), direction(before)) > math.radians(25)
            aligned = abs(between(direction(now), direction(wanted))) < math.radians(20)
            return turned and aligned and distance(now, wanted) < 0.05 and on_table(achieved, index)

        return Task(f"rotate_{self.name}_{side}", "rotate", suits, self.freely(suits), command, judge)

    def push(self, side: str, sign: int) -> Task:
        """Moved that way along the deck."""
        index = self.index

        def suits(achieved: Array) -> bool:
            return self.lying(achieved) and push_room(achieved, index, sign) >= _LEAST

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            x, y, z = block(achieved, index)[:3]
            far = rng.uniform(_LEAST, max(_LEAST, push_room(achieved, index, sign)))
            dx, dy = push_way(achieved, index, sign)
            return with_block(achieved, index, (x + far * dx, y + far * dy), z, direction(block(achieved, index)))

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            before, now, wanted = (block(a, index) for a in (start, achieved, goal))
            moved = sign * (now[1] - before[1]) > 0.04
            return bool(moved and distance(now, wanted) < NEAR and on_table(achieved, index))

        return Task(f"push_{self.name}_{side}", "push", suits, self.freely(suits), command, judge)

    def lifts(self) -> tuple[Task, ...]:
        """Taken up from the deck, from the bay, from the drawer."""
        index = self.index

        def lift(
            place: str, suits: Callable[[Array], bool], arrange: Callable[[Any, np.random.Generator], None]
        ) -> Task:
            def command(achieved: Array, rng: np.random.Generator) -> Array:
                pose = block(achieved, index)
                return with_block(achieved, index, pose[:2], pose[2] + rng.uniform(0.10, 0.13), direction(pose))

            def judge(start: Array, achieved: Array, goal: Array) -> bool:
                return bool(block(achieved, index)[2] > block(start, index)[2] + 0.04)

            kind = "lift" if place == "table" else "lift_out"
            return Task(f"lift_{self.name}_{place}", kind, suits, arrange, command, judge)

        def shelved(achieved: Array) -> bool:
            return in_bay(achieved, index) and clear(achieved, index) and not covered(achieved, index)

        def shelve(env: Any, rng: np.random.Generator) -> None:
            env.shelve(index, rng)
            env.refresh()
            env.slide_slider(0.0 if env.achieved()[5 * index + 1] > scene.BAY_CENTER[1] else scene.SLIDER_TRAVEL)
            env.refresh()

        def stowed(achieved: Array) -> bool:
            return in_tray(achieved, index) and clear(achieved, index) and achieved[DRAWER] > OPEN

        def stow(env: Any, rng: np.random.Generator) -> None:
            env.slide_drawer(rng.uniform(OPEN + 0.02, scene.DRAWER_TRAVEL))
            env.stow(index, rng)
            env.refresh()

        return (
            lift("table", self.lying, self.freely(self.lying)),
            lift("slider", shelved, shelve),
            lift("drawer", stowed, stow),
        )

    def freely(self, suits: Callable[[Array], bool]) -> Callable[[Any, np.random.Generator], None]:
        """It lies on the deck, anew until it suits."""

        def arrange(env: Any, rng: np.random.Generator) -> None:
            rest = np.stack([block(env.achieved(), i)[:2] for i in others(self.index)])
            for _ in range(DRAWS):
                if suits(env.achieved()):
                    return
                env.lay(self.index, free_spot(rest, rng), rng.uniform(-0.8, 0.8))
                env.refresh()

        return arrange

    def lying(self, achieved: Array) -> bool:
        return lies_free(achieved, self.index)


def push_way(achieved: Array, index: int, sign: int) -> tuple[float, float]:
    """The unit vector across the block's long side that points left (sign 1) or right (-1)."""
    yaw = direction(block(achieved, index))
    return -sign * math.sin(yaw), sign * math.cos(yaw)


def push_room(achieved: Array, index: int, sign: int) -> float:
    """How far, in meters, a block can be pushed left (1) or right (-1); 0 where fingers do not fit behind it."""
    x, y = block(achieved, index)[:2]
    dx, dy = push_way(achieved, index, sign)
    if abs(dy) < 0.64:  # it lies so that it would go forwards rather than aside
        return 0.0
    rest = [block(achieved, other)[:2] for other in others(index)]

    def room(far: float, away: float) -> bool:
        return all(math.hypot(x + far * dx - a, y + far * dy - b) > away for a, b in rest)

    far = 0.0
    while far < _REACH and room(-0.062, 0.06) and room(far + 0.01, 0.075):
        far += 0.01
        if not (FREE_X[0] - 0.02 <= x + far * dx <= FREE_X[1] and FREE_Y[0] <= y + far * dy <= FREE_Y[1]):
            return far - 0.01
    return far
