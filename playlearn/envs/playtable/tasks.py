"""The named tasks of PlayTable, CALVIN's 34 (Mees et al., 2022): where each starts, its goal, its success.

Left and right are the robot's: y > 0 is its left. Turned left is counter-clockwise as seen from above.
Where a task does not say which block, `command` draws one of those that suit; the goal tells which it was.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.block_tasks import DRAWS, LEFT, RIGHT, BlockTasks
from playlearn.envs.playtable.fixture_tasks import drawer_tasks, lamp_tasks, slider_tasks
from playlearn.envs.playtable.layout import (
    BLOCK_NAMES,
    BULB,
    DRAWER,
    LANDING_Y,
    LED,
    LYING_Z,
    OPEN,
    STOWED_Z,
    bases,
    block,
    clear,
    direction,
    distance,
    free_spot,
    in_bay,
    in_tray,
    lies_free,
    on_table,
    others,
    slider_y,
    supporter,
    tray_y,
    with_block,
)
from playlearn.episode import Array
from playlearn.sim.environment import Task

_ALL = range(len(BLOCK_NAMES))


def playtable_tasks() -> Mapping[str, Task]:
    """Name -> task, in the order that reports use."""
    blocks = [BlockTasks(index, name) for index, name in enumerate(BLOCK_NAMES)]
    sides = (("right", RIGHT), ("left", LEFT))
    tasks = (
        *(block.rotate(name, side) for block in blocks for name, side in sides),
        *(block.push(name, side) for block in blocks for name, side in sides),
        *slider_tasks(),
        *drawer_tasks(),
        *(lift for block in blocks for lift in block.lifts()),
        *_of_any_block(),
        *lamp_tasks("lightbulb", "lever", BULB),
        *lamp_tasks("led", "lamp", LED),
    )
    return MappingProxyType({task.name: task for task in tasks})


# Any block ----------------------------------------------------------------------------------------------


def _of_any_block() -> tuple[Task, ...]:
    return (
        Task(
            "place_in_slider", "shelve", _some(can_shelve), _as_it_comes, _with_some(can_shelve, shelved), _came(in_bay)
        ),
        Task("place_in_drawer", "stow", _some(can_stow), _opened, _with_some(can_stow, stowed), _came(in_tray)),
        Task(
            "push_into_drawer",
            "push_into_drawer",
            _some(can_drop),
            _near_edge,
            _with_some(can_drop, dropped),
            _came(in_tray),
        ),
        Task("stack_block", "stack", _some(can_stack), _as_it_comes, _with_some(can_stack, stacked), _stacked),
        Task("unstack_block", "unstack", _some(on_top), _piled, _with_some(on_top, placed), _unstacked),
    )


def can_shelve(achieved: Array, index: int) -> bool:
    return lies_free(achieved, index) and _bay_spot(achieved, index) is not None


def can_stow(achieved: Array, index: int) -> bool:
    return bool(lies_free(achieved, index) and achieved[DRAWER] > OPEN and not any(in_tray(achieved, i) for i in _ALL))


def can_drop(achieved: Array, index: int) -> bool:
    """Whether it lies before the open drawer, its long side to the edge, with fingers' room behind it."""
    pose = block(achieved, index)
    before = abs(pose[0] - scene.TRAY_X) < 0.045 and pose[1] > scene.EDGE_Y - 0.14
    rest = [block(achieved, other) for other in others(index)]
    lane = all(
        abs(other[0] - pose[0]) > 0.075 or other[1] < pose[1] - 0.11 for other in rest if other[2] < LYING_Z + 0.1
    )
    return bool(can_stow(achieved, index) and before and lane and abs(direction(pose)) < 0.18)


def can_stack(achieved: Array, index: int) -> bool:
    return lies_free(achieved, index) and bool(bases(achieved, index))


def on_top(achieved: Array, index: int) -> bool:
    return supporter(achieved, index) is not None and clear(achieved, index)


def shelved(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    """In the uncovered half of the bay, along it."""
    y = _bay_spot(achieved, index) or scene.BAY_CENTER[1]
    xy = (scene.BAY_CENTER[0] + rng.uniform(-0.01, 0.015), y + rng.uniform(-0.012, 0.012))
    return with_block(achieved, index, xy, LYING_Z, math.pi / 2 + rng.uniform(-0.15, 0.15))


def stowed(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    """In the middle of the drawer, along the way it slides."""
    xy = (
        scene.TRAY_X + rng.uniform(-0.02, 0.02),
        max(tray_y(achieved) + rng.uniform(-0.01, 0.02), scene.EDGE_Y + 0.055),
    )
    return with_block(achieved, index, xy, STOWED_Z, math.pi / 2 + rng.uniform(-0.15, 0.15))


def dropped(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    """Where it comes to lie when it is pushed over the edge."""
    pose = block(achieved, index)
    return with_block(achieved, index, (pose[0], LANDING_Y), STOWED_Z, direction(pose))


def before_drawer(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    """On the deck before the drawer, its long side to the edge, ready to be pushed in; unchanged if it does not fit."""
    for _ in range(20):
        xy = (scene.TRAY_X + rng.uniform(-0.04, 0.04), scene.EDGE_Y - rng.uniform(0.07, 0.12))
        goal = with_block(achieved, index, xy, LYING_Z, rng.uniform(-0.1, 0.1))
        if all(distance(block(goal, index), block(achieved, other)) > 0.10 for other in others(index)):
            return goal
    return achieved.copy()


def stacked(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    under = block(achieved, int(rng.choice(bases(achieved, index))))
    return with_block(achieved, index, under[:2], under[2] + 0.04, direction(under))


def placed(achieved: Array, index: int, rng: np.random.Generator) -> Array:
    """Lying on the deck, at least 12 cm from where it is now."""
    here, rest = block(achieved, index), np.stack([block(achieved, i)[:2] for i in others(index)])
    for _ in range(100):
        spot = free_spot(rest, rng)
        if distance(spot, here) > 0.12:
            break
    yaw = rng.uniform(-1.0, 1.0) if in_bay(achieved, index) or in_tray(achieved, index) else direction(here)
    return with_block(achieved, index, spot, LYING_Z, yaw)


def _bay_spot(achieved: Array, index: int) -> float | None:
    """The y of an uncovered half of the bay in which nothing lies, if there is one."""
    for y in (scene.BAY_CENTER[1] - 0.07, scene.BAY_CENTER[1] + 0.07):
        rest = [block(achieved, other) for other in others(index)]
        empty = all(math.hypot(o[0] - scene.BAY_CENTER[0], o[1] - y) > 0.085 for o in rest)
        if empty and abs(y - slider_y(achieved)) > 0.10:
            return y
    return None


def _some(suits: Callable[[Array, int], bool]) -> Callable[[Array], bool]:
    return lambda achieved: any(suits(achieved, index) for index in _ALL)


def _with_some(
    suits: Callable[[Array, int], bool], moved: Callable[[Array, int, np.random.Generator], Array]
) -> Callable[[Array, np.random.Generator], Array]:
    def command(achieved: Array, rng: np.random.Generator) -> Array:
        fit = [index for index in _ALL if suits(achieved, index)]
        return moved(achieved, int(rng.choice(fit)), rng) if fit else achieved.copy()

    return command


def _came(inside: Callable[[Array, int], bool]) -> Callable[[Array, Array, Array], bool]:
    """True exactly when every block that the goal shows newly there is there."""

    def judge(start: Array, achieved: Array, goal: Array) -> bool:
        new = [i for i in _ALL if inside(goal, i) and not inside(start, i)]
        return bool(new) and all(inside(achieved, i) for i in new)

    return judge


def _stacked(start: Array, achieved: Array, goal: Array) -> bool:
    """True exactly when every block that the goal shows newly on another is on that one."""
    new = {i: supporter(goal, i) for i in _ALL if supporter(goal, i) not in (None, supporter(start, i))}
    return bool(new) and all(supporter(achieved, i) == under for i, under in new.items())


def _unstacked(start: Array, achieved: Array, goal: Array) -> bool:
    """True exactly when every block that the goal shows taken off another lies on the deck."""
    off = [i for i in _ALL if supporter(start, i) is not None and supporter(goal, i) is None]
    return bool(off) and all(on_table(achieved, i) for i in off)


# Where they start ---------------------------------------------------------------------------------------


def _as_it_comes(env: Any, rng: np.random.Generator) -> None:
    """Nothing to bring about: most random starts suit."""


def _opened(env: Any, rng: np.random.Generator) -> None:
    env.slide_drawer(scene.DRAWER_TRAVEL - rng.uniform(0, 0.02))
    env.refresh()


def _near_edge(env: Any, rng: np.random.Generator) -> None:
    """A block before the open drawer, in which nothing lies."""
    env.slide_drawer(rng.uniform(OPEN + 0.01, scene.DRAWER_TRAVEL))
    env.vacate(in_tray, rng)
    index = int(rng.integers(len(BLOCK_NAMES)))
    for _ in range(DRAWS):
        ready = before_drawer(env.achieved(), index, rng)
        env.lay(index, block(ready, index)[:2], direction(block(ready, index)))
        env.refresh()
        if can_drop(env.achieved(), index):
            return


def _piled(env: Any, rng: np.random.Generator) -> None:
    top, below = rng.permutation(len(BLOCK_NAMES))[:2]
    env.lay(int(below), free_spot(np.stack([block(env.achieved(), i)[:2] for i in others(int(below))]), rng), 0.0)
    env.stack(int(top), int(below), rng)
    env.refresh()
