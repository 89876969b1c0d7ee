"""The named tasks of the fixtures: the slider, the drawer, the two lamps."""

from collections.abc import Callable
from typing import Any

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.block_tasks import LEFT, RIGHT
from playlearn.envs.playtable.layout import BULB, CLOSED, DRAWER, LEVER, OPEN, SLIDER, with_drawer
from playlearn.episode import Array
from playlearn.sim.environment import Task

_SLID = 0.02  # meters from its ends at which the slider counts as left or right


def slider_tasks() -> tuple[Task, ...]:
    """Slid to its left end, to its right end."""

    def slide(name: str, sign: int) -> Task:
        ends = {RIGHT: (0.0, _SLID), LEFT: (scene.SLIDER_TRAVEL - _SLID, scene.SLIDER_TRAVEL)}

        def suits(achieved: Array) -> bool:
            return bool(abs(achieved[SLIDER] - np.mean(ends[sign])) > 0.08)

        def arrange(env: Any, rng: np.random.Generator) -> None:
            env.slide_slider(rng.uniform(*ends[-sign]))
            env.refresh()

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[SLIDER] = rng.uniform(*ends[sign])
            return goal

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            return bool(abs(achieved[SLIDER] - goal[SLIDER]) < 0.03)

        return Task(f"move_slider_{name}", "slider", suits, arrange, command, judge)

    return slide("left", LEFT), slide("right", RIGHT)


def drawer_tasks() -> tuple[Task, ...]:
    """Opened, closed."""
    closed, opened = (0.0, 0.01), (scene.DRAWER_TRAVEL - 0.02, scene.DRAWER_TRAVEL)

    def slide(
        name: str, suits: Callable[[Array], bool], before: tuple[float, float], after: tuple[float, float]
    ) -> Task:
        def arrange(env: Any, rng: np.random.Generator) -> None:
            env.slide_drawer(rng.uniform(*before))
            env.refresh()

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            return with_drawer(achieved, rng.uniform(*after))

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            return bool(abs(achieved[DRAWER] - goal[DRAWER]) < 0.03)

        return Task(name, name, suits, arrange, command, judge)

    return (
        slide("open_drawer", lambda achieved: bool(achieved[DRAWER] < CLOSED), closed, opened),
        slide("close_drawer", lambda achieved: bool(achieved[DRAWER] > OPEN), opened, closed),
    )


def lamp_tasks(name: str, kind: str, index: int) -> tuple[Task, ...]:
    """Turned on, turned off. kind: of skill that switches it; index: of `achieved`, where it shows."""

    def switch(verb: str, lit: bool) -> Task:
        def arrange(env: Any, rng: np.random.Generator) -> None:
            env.switch(**{kind: not lit})
            env.refresh()

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[index] = float(lit)
            if index == BULB:
                goal[LEVER] = scene.LEVER_RANGE if lit else -scene.LEVER_RANGE
            return goal

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            return bool((achieved[index] > 0.5) == lit)

        def suits(achieved: Array) -> bool:
            return bool((achieved[index] > 0.5) != lit)

        return Task(f"turn_{verb}_{name}", kind, suits, arrange, command, judge)

    return switch("on", True), switch("off", False)
