"""The named tasks of PlayTable: where each starts, what it asks for, and how it is judged."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.episode import Array
from playlearn.sim import playtable_scene as scene
from playlearn.sim.environment import Task

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
        for task in _of_block(index, name):
            tasks[task.name] = task
    for task in (*_of_drawer(), *_of_lamp()):
        tasks[task.name] = task
    return MappingProxyType(tasks)


def _of_block(index: int, name: str) -> tuple[Task, ...]:
    others = [i for i in range(len(BLOCK_NAMES)) if i != index]

    def lying(achieved: Array) -> bool:
        return on_table(achieved, index) and clear(achieved, index)

    def moved(achieved: Array, **parts: Any) -> Array:
        goal = achieved.copy()
        pose = block(goal, index)
        if "xy" in parts:
            pose[:2] = parts["xy"]
        pose[2] = parts.get("z", pose[2])
        yaw = parts.get("yaw", direction(pose))
        pose[3:] = (np.cos(2 * yaw), np.sin(2 * yaw))
        return goal

    def spot(achieved: Array, rng: np.random.Generator, nearest: float) -> Array:
        rest = np.stack([block(achieved, i)[:2] for i in others])
        here = block(achieved, index)[:2]
        for _ in range(100):
            place = free_spot(rest, rng)
            if np.hypot(*(place - here)) > nearest:
                break
        return place

    def lift(achieved: Array, rng: np.random.Generator) -> Array:
        return moved(achieved, z=block(achieved, index)[2] + rng.uniform(0.09, 0.13))

    def push(achieved: Array, rng: np.random.Generator) -> Array:
        pose = block(achieved, index)
        rest = np.stack([block(achieved, i)[:2] for i in others])
        across = direction(pose) + np.pi / 2
        for _ in range(50):
            way = rng.choice([-1.0, 1.0]) * np.array([np.cos(across), np.sin(across)])
            place = pose[:2] + way * rng.uniform(0.06, 0.10)
            inside = FREE_X[0] <= place[0] <= FREE_X[1] and FREE_Y[0] <= place[1] <= FREE_Y[1]
            if inside and (np.hypot(*(rest - place).T) > 0.075).all():
                return moved(achieved, xy=place)
        return achieved.copy()

    def rotate(achieved: Array, rng: np.random.Generator) -> Array:
        yaw = direction(block(achieved, index))
        turns = [turn for turn in rng.uniform(0.7, 1.2, 2) * (1, -1) if abs(yaw + turn) < 1.25]
        return moved(achieved, yaw=yaw + (turns[0] if len(turns) == 1 else rng.choice(turns or [0.0])))

    def place(achieved: Array, rng: np.random.Generator) -> Array:
        return moved(achieved, xy=spot(achieved, rng, 0.12), z=LYING_Z)

    def stow(achieved: Array, rng: np.random.Generator) -> Array:
        xy = scene.tray_centre(float(achieved[DRAWER])) + rng.uniform((-0.05, -0.012), (-0.01, 0.012))
        return moved(achieved, xy=xy, z=scene.TRAY_FLOOR + 0.02, yaw=0.0)

    def stack(achieved: Array, rng: np.random.Generator) -> Array:
        free = [i for i in others if clear(achieved, i) and on_table(achieved, i)]
        under = block(achieved, int(rng.choice(free or others)))
        return moved(achieved, xy=under[:2], z=under[2] + 0.04, yaw=direction(under))

    def can_stack(achieved: Array) -> bool:
        return lying(achieved) and any(clear(achieved, i) and on_table(achieved, i) for i in others)

    def on_top(achieved: Array) -> bool:
        return supporter(achieved, index) is not None and clear(achieved, index)

    def distance(achieved: Array, goal: Array) -> float:
        return float(np.hypot(*(block(achieved, index)[:2] - block(goal, index)[:2])))

    def at_goal(start: Array, achieved: Array, goal: Array) -> bool:
        return distance(achieved, goal) < NEAR and on_table(achieved, index)

    def turned(start: Array, achieved: Array, goal: Array) -> bool:
        off = direction(block(achieved, index)) - direction(block(goal, index))
        off = (off + np.pi / 2) % np.pi - np.pi / 2
        return bool(abs(off) < np.deg2rad(20) and distance(achieved, goal) < 0.05)

    def lifted(start: Array, achieved: Array, goal: Array) -> bool:
        return bool(block(achieved, index)[2] > block(start, index)[2] + 0.04)

    def stacked(start: Array, achieved: Array, goal: Array) -> bool:
        return supporter(achieved, index) is not None and supporter(achieved, index) == supporter(goal, index)

    def close_by(achieved: Array) -> bool:
        return bool(np.isfinite(achieved).all()) and lying(achieved)

    def loose(env: Any, rng: np.random.Generator) -> None:
        """Nothing to bring about: most random starts suit."""

    def pile(env: Any, rng: np.random.Generator) -> None:
        env.stack(index, int(rng.choice(others)), rng)
        env.refresh()

    def opened(env: Any, rng: np.random.Generator) -> None:
        env.slide_drawer(scene.DRAWER_TRAVEL - rng.uniform(0, 0.02))
        env.refresh()

    def open_and_lying(achieved: Array) -> bool:
        return bool(lying(achieved) and achieved[DRAWER] > OPEN)

    return (
        Task(f"lift_{name}", lying, loose, lift, lifted),
        Task(f"push_{name}", close_by, loose, push, at_goal),
        Task(f"rotate_{name}", lying, loose, rotate, turned),
        Task(f"place_{name}", lying, loose, place, at_goal),
        Task(f"stow_{name}", open_and_lying, opened, stow, lambda start, achieved, goal: in_tray(achieved, index)),
        Task(f"stack_{name}", can_stack, loose, stack, stacked),
        Task(f"unstack_{name}", on_top, pile, place, lambda start, achieved, goal: on_table(achieved, index)),
    )


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

    travel = scene.DRAWER_TRAVEL
    return (
        Task("open_drawer", lambda a: bool(a[DRAWER] < CLOSED), arrange(0, 0.01), slide(travel - 0.02, travel), near),
        Task("close_drawer", lambda a: bool(a[DRAWER] > OPEN), arrange(travel - 0.02, travel), slide(0, 0.01), near),
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

        return Task(name, lambda achieved: bool((achieved[LAMP] > 0.5) != lit), arrange, command, judge)

    return task("lamp_on", True), task("lamp_off", False)
