"""The named tasks of PlayTable: where each starts, what it asks for, and how it is judged."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.episode import Array
from playlearn.sim.environment import Task
from playlearn.tasks.playtable import scene

Range = tuple[float, float]

BLOCK_NAMES = tuple(scene.BLOCKS)
DRAWER, LAMP = 15, 16
LYING_Z = scene.TABLE_Z + 0.02
FREE_X, FREE_Y = (-0.12, 0.17), (-0.19, 0.05)  # where blocks are laid, metres
OPEN, CLOSED = 0.12, 0.03  # metres of drawer opening
NEAR = 0.04  # metres


def block(achieved: Array, index: int) -> Array:
    """(5,) x, y, z, c, s of one block: a view."""
    return achieved[5 * index : 5 * index + 5]


def direction(pose: Array) -> float:
    """Yaw of a block's long axis in (-pi/2, pi/2] from its (c, s)."""
    return float(np.arctan2(pose[4], pose[3]) / 2)


def free_spot(others: Array, rng: np.random.Generator, away: float = 0.09) -> Array:
    """(2,) a random place to lay a block, `away` metres from all `others` (n, 2)."""
    for _ in range(200):
        spot = rng.uniform((FREE_X[0], FREE_Y[0]), (FREE_X[1], FREE_Y[1]))
        if (np.hypot(*(others - spot).T) > away).all():
            break
    return spot


def in_tray(achieved: Array, index: int) -> bool:
    """Whether block `index` lies in the drawer."""
    pose, centre = block(achieved, index), scene.tray_centre(float(achieved[DRAWER]))
    return bool((np.abs(pose[:2] - centre) < scene.TRAY_HALF).all() and pose[2] < scene.TABLE_Z + 0.05)


def on_table(achieved: Array, index: int) -> bool:
    """Whether block `index` lies flat on the table itself."""
    pose = block(achieved, index)
    return bool(abs(pose[2] - LYING_Z) < 0.012 and not in_tray(achieved, index))


def supporter(achieved: Array, index: int) -> int | None:
    """The block that block `index` rests on, if any."""
    pose = block(achieved, index)
    for other in range(len(BLOCK_NAMES)):
        under = block(achieved, other)
        if other != index and np.hypot(*(pose[:2] - under[:2])) < 0.04 and abs(pose[2] - under[2] - 0.04) < 0.015:
            return other
    return None


def clear(achieved: Array, index: int) -> bool:
    """Whether nothing rests on block `index`."""
    return all(supporter(achieved, other) != index for other in range(len(BLOCK_NAMES)))


def playtable_tasks() -> Mapping[str, Task]:
    """Name -> task, in the order that reports use."""
    tasks: dict[str, Task] = {}
    for index, name in enumerate(BLOCK_NAMES):
        for task in _BlockTasks(index, name).tasks():
            tasks[task.name] = task
    for task in (*_of_drawer(), *_of_lamp()):
        tasks[task.name] = task
    return MappingProxyType(tasks)


@dataclass(frozen=True)
class _BlockTasks:
    """The seven tasks of one block."""

    index: int
    name: str

    def tasks(self) -> tuple[Task, ...]:
        name = self.name
        return (
            Task(f"lift_{name}", "lift", self.lying, _as_it_comes, self.lift, self.lifted),
            Task(f"push_{name}", "push", self.lying, _as_it_comes, self.push, self.at_goal),
            Task(f"rotate_{name}", "rotate", self.lying, _as_it_comes, self.rotate, self.turned),
            Task(f"place_{name}", "place", self.lying, _as_it_comes, self.place, self.at_goal),
            Task(f"stow_{name}", "stow", self.can_stow, _opened, self.stow, self.stowed),
            Task(f"stack_{name}", "stack", self.can_stack, _as_it_comes, self.stack, self.stacked),
            Task(f"unstack_{name}", "unstack", self.on_top, self.pile, self.place, self.unstacked),
        )

    @property
    def others(self) -> list[int]:
        return [i for i in range(len(BLOCK_NAMES)) if i != self.index]

    # Where a task can start -------------------------------------------------------------------------

    def lying(self, achieved: Array) -> bool:
        return on_table(achieved, self.index) and clear(achieved, self.index)

    def can_stow(self, achieved: Array) -> bool:
        return bool(self.lying(achieved) and achieved[DRAWER] > OPEN)

    def can_stack(self, achieved: Array) -> bool:
        return self.lying(achieved) and bool(self._bases(achieved))

    def on_top(self, achieved: Array) -> bool:
        return supporter(achieved, self.index) is not None and clear(achieved, self.index)

    def pile(self, env: Any, rng: np.random.Generator) -> None:
        env.stack(self.index, int(rng.choice(self.others)), rng)
        env.refresh()

    # What it asks for -------------------------------------------------------------------------------

    def lift(self, achieved: Array, rng: np.random.Generator) -> Array:
        return self._moved(achieved, z=block(achieved, self.index)[2] + rng.uniform(0.09, 0.13))

    def push(self, achieved: Array, rng: np.random.Generator) -> Array:
        """Across its long side, as far as there is room; the goal is `achieved` itself where there is none."""
        pose = block(achieved, self.index)
        rest = np.stack([block(achieved, i)[:2] for i in self.others])
        across = direction(pose) + np.pi / 2
        for _ in range(50):
            way = rng.choice([-1.0, 1.0]) * np.array([np.cos(across), np.sin(across)])
            place = pose[:2] + way * rng.uniform(0.06, 0.10)
            inside = FREE_X[0] <= place[0] <= FREE_X[1] and FREE_Y[0] <= place[1] <= FREE_Y[1]
            if inside and (np.hypot(*(rest - place).T) > 0.075).all():
                return self._moved(achieved, xy=place)
        return achieved.copy()

    def rotate(self, achieved: Array, rng: np.random.Generator) -> Array:
        yaw = direction(block(achieved, self.index))
        turns = [turn for turn in rng.uniform(0.7, 1.2, 2) * (1, -1) if abs(yaw + turn) < 1.25]
        return self._moved(achieved, yaw=yaw + (turns[0] if len(turns) == 1 else rng.choice(turns or [0.0])))

    def place(self, achieved: Array, rng: np.random.Generator) -> Array:
        """Lying on the table, at least 12 cm from where it is now."""
        rest = np.stack([block(achieved, i)[:2] for i in self.others])
        here = block(achieved, self.index)[:2]
        for _ in range(100):
            spot = free_spot(rest, rng)
            if np.hypot(*(spot - here)) > 0.12:
                break
        return self._moved(achieved, xy=spot, z=LYING_Z)

    def stow(self, achieved: Array, rng: np.random.Generator) -> Array:
        xy = scene.tray_centre(float(achieved[DRAWER])) + rng.uniform((-0.05, -0.012), (-0.01, 0.012))
        return self._moved(achieved, xy=xy, z=scene.TRAY_FLOOR + 0.02, yaw=0.0)

    def stack(self, achieved: Array, rng: np.random.Generator) -> Array:
        under = block(achieved, int(rng.choice(self._bases(achieved) or self.others)))
        return self._moved(achieved, xy=under[:2], z=under[2] + 0.04, yaw=direction(under))

    # How it is judged -------------------------------------------------------------------------------

    def at_goal(self, start: Array, achieved: Array, goal: Array) -> bool:
        return self._distance(achieved, goal) < NEAR and on_table(achieved, self.index)

    def turned(self, start: Array, achieved: Array, goal: Array) -> bool:
        off = direction(block(achieved, self.index)) - direction(block(goal, self.index))
        off = (off + np.pi / 2) % np.pi - np.pi / 2
        return bool(abs(off) < np.deg2rad(20) and self._distance(achieved, goal) < 0.05)

    def lifted(self, start: Array, achieved: Array, goal: Array) -> bool:
        return bool(block(achieved, self.index)[2] > block(start, self.index)[2] + 0.04)

    def stowed(self, start: Array, achieved: Array, goal: Array) -> bool:
        return in_tray(achieved, self.index)

    def stacked(self, start: Array, achieved: Array, goal: Array) -> bool:
        base = supporter(achieved, self.index)
        return base is not None and base == supporter(goal, self.index)

    def unstacked(self, start: Array, achieved: Array, goal: Array) -> bool:
        return on_table(achieved, self.index)

    def _bases(self, achieved: Array) -> list[int]:
        """The blocks that this one could be stacked on."""
        return [i for i in self.others if clear(achieved, i) and on_table(achieved, i)]

    def _distance(self, achieved: Array, goal: Array) -> float:
        return float(np.hypot(*(block(achieved, self.index)[:2] - block(goal, self.index)[:2])))

    def _moved(
        self, achieved: Array, xy: Array | None = None, z: float | None = None, yaw: float | None = None
    ) -> Array:
        goal = achieved.copy()
        pose = block(goal, self.index)
        if xy is not None:
            pose[:2] = xy
        if z is not None:
            pose[2] = z
        if yaw is not None:
            pose[3:] = (np.cos(2 * yaw), np.sin(2 * yaw))
        return goal


def _as_it_comes(env: Any, rng: np.random.Generator) -> None:
    """Nothing to bring about: most random starts suit."""


def _opened(env: Any, rng: np.random.Generator) -> None:
    env.slide_drawer(scene.DRAWER_TRAVEL - rng.uniform(0, 0.02))
    env.refresh()


def _of_drawer() -> tuple[Task, ...]:
    def slide(low: float, high: float) -> Callable[[Array, np.random.Generator], Array]:
        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[DRAWER] = rng.uniform(low, high)
            carry = goal[DRAWER] - achieved[DRAWER]
            for index in range(len(BLOCK_NAMES)):
                if in_tray(achieved, index):
                    block(goal, index)[1] -= carry
            return goal

        return command

    def arrange(low: float, high: float) -> Callable[[Any, np.random.Generator], None]:
        def bring(env: Any, rng: np.random.Generator) -> None:
            env.slide_drawer(rng.uniform(low, high))
            env.refresh()

        return bring

    def near(start: Array, achieved: Array, goal: Array) -> bool:
        return bool(abs(achieved[DRAWER] - goal[DRAWER]) < 0.03)

    def drawer(kind: str, suits: Callable[[Array], bool], before: Range, after: Range) -> Task:
        return Task(kind, kind, suits, arrange(*before), slide(*after), near)

    closed, opened = (0.0, 0.01), (scene.DRAWER_TRAVEL - 0.02, scene.DRAWER_TRAVEL)
    return (
        drawer("open_drawer", lambda achieved: bool(achieved[DRAWER] < CLOSED), closed, opened),
        drawer("close_drawer", lambda achieved: bool(achieved[DRAWER] > OPEN), opened, closed),
    )


def _of_lamp() -> tuple[Task, ...]:
    def task(name: str, lit: bool) -> Task:
        def arrange(env: Any, rng: np.random.Generator) -> None:
            env.switch(not lit)

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[LAMP] = float(lit)
            return goal

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            return bool((achieved[LAMP] > 0.5) == lit)

        return Task(name, "lamp", lambda achieved: bool((achieved[LAMP] > 0.5) != lit), arrange, command, judge)

    return task("lamp_on", True), task("lamp_off", False)
