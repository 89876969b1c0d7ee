"""The skill library of PlayTable: what play tries there, and which skill serves a goal."""

from collections.abc import Callable, Sequence

import numpy as np

from playlearn.envs.playtable import scene
from playlearn.envs.playtable.grasp import Block
from playlearn.envs.playtable.layout import (
    BLOCK_NAMES,
    BULB,
    DRAWER,
    LED,
    LYING_Z,
    SLIDER,
    bases,
    block,
    clear,
    covered,
    in_bay,
    in_tray,
    lies_free,
    upright,
)
from playlearn.envs.playtable.order import carry, in_hand, next_skill
from playlearn.envs.playtable.skills import POSTS, Flip, Press, PushIn, Slide, Tip
from playlearn.envs.playtable.tasks import (
    before_drawer,
    can_drop,
    can_shelve,
    can_stow,
    placed,
    playtable_tasks,
    shelved,
    stacked,
    stowed,
)
from playlearn.episode import Array
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skill_library import SkillOption
from playlearn.oracles.skills import Push, Skill
from playlearn.sim.environment import Task

# How often play tries each kind, where it can: more of what is seldom possible.
_WEIGHTS = {
    "lift": 0.3,
    "lift_out": 3.0,
    "push": 0.5,
    "rotate": 0.4,
    "place": 0.6,
    "approach": 1.2,
    "stow": 3.0,
    "shelve": 1.6,
    "push_into_drawer": 10.0,
    "stack": 1.5,
    "unstack": 2.0,
    "unstow": 2.5,
    "unshelve": 1.5,
    "tip": 4.0,
    "open_drawer": 4.0,
    "close_drawer": 2.0,
    "slide": 0.4,
    "slider": 1.4,
    "lamp": 1.4,
    "lever": 1.4,
}
_ALL = range(len(BLOCK_NAMES))
Moved = Callable[[Array, int, np.random.Generator], Array]


class PlayTableSkillLibrary:
    """The `SkillLibrary` of PlayTable."""

    idle = ((-0.15, -0.2, scene.TABLE_Z + 0.14), (0.13, 0.2, scene.TABLE_Z + 0.25))

    def __init__(self) -> None:
        self._tasks = playtable_tasks()

    def options(self) -> Sequence[SkillOption]:
        """The named tasks and what is none: laying a block elsewhere, out of drawer and bay, on its side."""
        named = [_option(task) for task in self._tasks.values()]
        own = [option for index in _ALL for option in _of_block(index)]
        return [*named, *own, _anywhere("drawer", DRAWER), _anywhere("slider", SLIDER)]

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        return in_hand(hand, achieved) is not None

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        index = in_hand(hand, achieved)
        if index is None:
            return self.towards(hand, achieved, achieved)
        free = achieved.copy()
        block(free, index)[:3] = (scene.TRAY_X, -0.03, LYING_Z)  # as if it lay on the deck
        ways: list[tuple[str, Moved]] = [("place", placed)]
        ways += [("stow", stowed)] if can_stow(free, index) else []
        ways += [("shelve", shelved)] if can_shelve(free, index) else []
        ways += [("stack", stacked)] if bases(free, index) else []
        kind, moved = ways[int(rng.integers(len(ways)))]
        return carry(hand, achieved, index, block(moved(free, index, rng), index), f"{kind}_{BLOCK_NAMES[index]}")

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        return next_skill(hand, achieved, goal)


def _option(task: Task) -> SkillOption:
    def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill | None:
        return _skill_for(task, task.command(achieved, rng), hand, achieved)

    return SkillOption(task.name, task.kind, task.precondition, skill, _WEIGHTS[task.kind])


def _skill_for(task: Task, goal: Array, hand: EndEffector, achieved: Array) -> Skill | None:
    """The skill by which play brings about the goal of a named task; None where nothing is to be done."""
    name = task.name
    if task.kind in ("open_drawer", "close_drawer"):
        return Slide(name, POSTS[DRAWER], float(goal[DRAWER]))
    if task.kind == "slider":
        return Slide(name, POSTS[SLIDER], float(goal[SLIDER]))
    if task.kind == "lamp":
        return Press(name, bool(goal[LED] > 0.5))
    if task.kind == "lever":
        return Flip(name, bool(goal[BULB] > 0.5))
    index = next((i for i in _ALL if not np.allclose(block(goal, i), block(achieved, i), atol=1e-4)), None)
    if index is None:
        return None
    if task.kind == "push":
        x, y, z = map(float, block(goal, index)[:3])
        return Push(name, Block(index), (x, y, z))
    if task.kind == "push_into_drawer":
        return PushIn(name, index)
    return carry(hand, achieved, index, block(goal, index), name, lasting=task.kind not in ("lift", "lift_out"))


def _of_block(index: int) -> list[SkillOption]:
    """What play does with a block that is no named task: laying it elsewhere, before the drawer, on its side."""
    name = BLOCK_NAMES[index]

    def put(kind: str, possible: Callable[[Array], bool], to: Moved = placed) -> SkillOption:
        def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill | None:
            goal = to(achieved, index, rng)
            if np.array_equal(goal, achieved):
                return None
            return carry(hand, achieved, index, block(goal, index), f"{kind}_{name}")

        return SkillOption(f"{kind}_{name}", kind, possible, skill, _WEIGHTS[kind])

    def tip(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        return Tip(f"tip_{name}", index)

    return [
        put("place", lambda achieved: lies_free(achieved, index)),
        put("approach", lambda achieved: can_stow(achieved, index) and not can_drop(achieved, index), before_drawer),
        put("unstow", lambda achieved: _out_of_drawer(achieved, index)),
        put("unshelve", lambda achieved: _out_of_bay(achieved, index)),
        SkillOption(f"tip_{name}", "tip", lambda achieved: upright(block(achieved, index)), tip, _WEIGHTS["tip"]),
    ]


def _out_of_drawer(achieved: Array, index: int) -> bool:
    return bool(in_tray(achieved, index) and achieved[DRAWER] > 0.14 and clear(achieved, index))


def _out_of_bay(achieved: Array, index: int) -> bool:
    return in_bay(achieved, index) and clear(achieved, index) and not covered(achieved, index)


def _anywhere(name: str, index: int) -> SkillOption:
    """A fixture slid to any place."""

    def skill(hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        return Slide(f"slide_{name}", POSTS[index], float(rng.uniform(0, POSTS[index].travel)))

    return SkillOption(f"slide_{name}", "slide", lambda _: True, skill, _WEIGHTS["slide"])
