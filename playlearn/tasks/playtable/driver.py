"""Who drives PlayTable: what play tries there, and which skill comes next on the way to a goal."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.sim.environment import Task
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.named import (
    BLOCK_NAMES,
    DRAWER,
    LAMP,
    block,
    clear,
    direction,
    in_tray,
    playtable_tasks,
)
from playlearn.tasks.playtable.skills import HIGH, Block, Press, Push, Slide
from playlearn.teleop.driver import Idea
from playlearn.teleop.hand import Hand
from playlearn.teleop.skills import Carry, Reach, Skill

OPEN_ENOUGH = 0.11  # metres of drawer opening at which a block can be laid in or taken out
_HOLLOW = 0.01  # metres above its place at which a block is let go in the tray
# How often play tries each kind, where it can: more of what is seldom possible.
_WEIGHTS = {
    "lift": 0.6,
    "push": 1.0,
    "rotate": 0.8,
    "place": 1.6,
    "stow": 1.2,
    "stack": 1.0,
    "unstack": 2.0,
    "unstow": 2.0,
    "open_drawer": 2.0,
    "close_drawer": 1.2,
    "lamp": 1.6,
}


class PlayTableDriver:
    """A `Driver`; see there."""

    aimless = ((-0.15, -0.2, scene.TABLE_Z + 0.12), (0.15, 0.2, scene.TABLE_Z + 0.25))

    def __init__(self) -> None:
        self._tasks = playtable_tasks()

    def ideas(self) -> Sequence[Idea]:
        """The named tasks, and taking a block out of the drawer."""
        named = [self._idea(task) for task in self._tasks.values()]
        return [*named, *(self._unstow(index) for index in range(len(BLOCK_NAMES)))]

    def holding(self, hand: Hand, achieved: Array) -> bool:
        return _in_hand(hand, achieved) is not None

    def put_down(self, hand: Hand, achieved: Array, rng: np.random.Generator) -> Skill:
        index = _in_hand(hand, achieved)
        if index is None:
            return self.towards(hand, achieved, achieved)
        kinds = ["place"]
        if achieved[DRAWER] > 0.12:
            kinds.append("stow")
        if any(clear(achieved, i) and block(achieved, i)[2] < scene.TABLE_Z + 0.03 for i in range(3) if i != index):
            kinds.append("stack")
        name = f"{kinds[int(rng.integers(len(kinds)))]}_{BLOCK_NAMES[index]}"
        return _carry(self._tasks[name].command(achieved, rng), index, name)

    def towards(self, hand: Hand, achieved: Array, goal: Array) -> Skill:
        """The order is part of the skill.

        What is in hand comes first; then the drawer, where a block must get in or out; the lower block of a
        stack before the upper one; the drawer's own goal after what lies in it.
        """
        wrong = [i for i in range(len(BLOCK_NAMES)) if not _block_there(achieved, goal, i)]
        held = _in_hand(hand, achieved)
        if held in wrong:
            return _carry(goal, held)
        through_drawer = [i for i in wrong if in_tray(goal, i) != in_tray(achieved, i) or in_tray(achieved, i)]
        moved_along = [i for i in through_drawer if in_tray(goal, i) and in_tray(achieved, i)]
        if moved_along and abs(goal[DRAWER] - achieved[DRAWER]) > 0.02:
            return Slide("drawer", float(goal[DRAWER]))
        if through_drawer and achieved[DRAWER] < OPEN_ENOUGH:
            return Slide("drawer", scene.DRAWER_TRAVEL - 0.01)
        for i in sorted(wrong, key=lambda i: (not clear(achieved, i), goal[5 * i + 2])):
            return _carry(goal, i)
        if abs(goal[DRAWER] - achieved[DRAWER]) > 0.02:
            return Slide("drawer", float(goal[DRAWER]))
        if (goal[LAMP] > 0.5) != (achieved[LAMP] > 0.5):
            return Press("press", bool(goal[LAMP] > 0.5))
        if held is not None:
            return _carry(goal, held)
        return Reach("rest", (float(hand.position[0]), float(hand.position[1]), HIGH))

    def _idea(self, task: Task) -> Idea:
        def skill(hand: Hand, achieved: Array, rng: np.random.Generator) -> Skill | None:
            return _skill_for(task.name, task.command(achieved, rng), achieved)

        return Idea(task.name, task.kind, task.precondition, skill, _WEIGHTS.get(task.kind, 1.0))

    def _unstow(self, index: int) -> Idea:
        def possible(achieved: Array) -> bool:
            return bool(in_tray(achieved, index) and achieved[DRAWER] > 0.12 and clear(achieved, index))

        def skill(hand: Hand, achieved: Array, rng: np.random.Generator) -> Skill:
            goal = self._tasks[f"place_{BLOCK_NAMES[index]}"].command(achieved, rng)
            return _carry(goal, index, f"place_{BLOCK_NAMES[index]}")

        return Idea(f"unstow_{BLOCK_NAMES[index]}", "unstow", possible, skill, _WEIGHTS["unstow"])


def _skill_for(name: str, goal: Array, achieved: Array) -> Skill | None:
    """The skill by which play brings about the goal of the named task; None where there was no room for it."""
    if name.endswith("drawer"):
        return Slide(name, float(goal[DRAWER]))
    if name.startswith("lamp"):
        return Press(name, bool(goal[LAMP] > 0.5))
    index = BLOCK_NAMES.index(name.partition("_")[2])
    pose = block(goal, index)
    if np.allclose(pose, block(achieved, index), atol=1e-4):
        return None
    if name.startswith("push"):
        return Push(name, index, (float(pose[0]), float(pose[1])))
    return _carry(goal, index, name)


def _in_hand(hand: Hand, achieved: Array) -> int | None:
    return next((i for i in range(len(BLOCK_NAMES)) if Block(i).held(hand, achieved)), None)


def _block_there(achieved: Array, goal: Array, index: int) -> bool:
    at, to = block(achieved, index), block(goal, index)
    off = (direction(at) - direction(to) + np.pi / 2) % np.pi - np.pi / 2
    return bool(np.hypot(*(at[:2] - to[:2])) < 0.025 and abs(at[2] - to[2]) < 0.015 and abs(off) < 0.3)


def _carry(goal: Array, index: int, name: str | None = None) -> Carry:
    pose = block(goal, index)
    resting = in_tray(goal, index) or pose[2] < scene.TABLE_Z + 0.03 or _supported(goal, index)
    stowing = pose[1] > 0.08 and pose[2] < scene.TABLE_Z + 0.05
    return Carry(
        name or f"carry_{BLOCK_NAMES[index]}",
        Block(index),
        (float(pose[0]), float(pose[1]), float(pose[2])),
        direction(pose),
        lasting=resting,
        drop=_HOLLOW if stowing else 0.002,
    )


def _supported(goal: Array, index: int) -> bool:
    pose = block(goal, index)
    below = [block(goal, i) for i in range(len(BLOCK_NAMES)) if i != index]
    return any(np.hypot(*(pose[:2] - b[:2])) < 0.045 and 0.025 < pose[2] - b[2] < 0.055 for b in below)
