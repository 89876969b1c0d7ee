"""A closed-loop expert for PlayTable: from any state towards any goal state, one action at a time."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.sim import playtable_scene as scene
from playlearn.sim.playtable_tasks import BLOCK_NAMES, DRAWER, LAMP, block, clear, direction, in_tray
from playlearn.teleop.hand import Hand, Style
from playlearn.teleop.playtable_skills import HIGH, Carry, Press, Push, Reach, Skill, Slide, holding

OPEN_ENOUGH = 0.11  # metres of drawer opening at which a block can be laid in or taken out


def skill_towards(hand: Hand, achieved: Array, goal: Array) -> Skill:
    """What to do now to bring `achieved` (17,) to `goal` (17,); the order is part of the skill.

    What is in hand comes first; then the drawer, where a block must get in or out; the lower block of a
    stack before the upper one; the drawer's own goal after what lies in it.
    """
    wrong = [i for i in range(len(BLOCK_NAMES)) if not _block_there(achieved, goal, i)]
    for i in wrong:
        if holding(hand, achieved, i):
            return _carry(goal, i)
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
    held = [i for i in range(len(BLOCK_NAMES)) if holding(hand, achieved, i)]
    if held:
        return _carry(goal, held[0])
    return Reach("rest", (float(hand.position[0]), float(hand.position[1]), HIGH))


def skill_for(name: str, goal: Array, changed: Sequence[int], achieved: Array) -> Skill:
    """The skill by which play brings about the goal of the named task; `changed` are its blocks."""
    if name.endswith("drawer") and not changed:
        return Slide(name, float(goal[DRAWER]))
    if name.startswith("lamp"):
        return Press(name, bool(goal[LAMP] > 0.5))
    index = changed[0]
    pose = block(goal, index)
    if name.startswith("push"):
        return Push(name, index, (float(pose[0]), float(pose[1])))
    return _carry(goal, index, name)


class PlayTableExpert:
    """An Actor that is asked for an action in any state; the reference row of every evaluation."""

    name = "expert"
    cameras: tuple[str, ...] = ()

    def __init__(self, style: Style | None = None) -> None:
        self._style = style or Style()
        self._goals: list[Array] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._goals = [np.zeros(0) if goal is None else goal.achieved for goal in goals]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        return [self._one(seen, goal) for seen, goal in zip(observations, self._goals, strict=True)]

    def _one(self, seen: Observation, goal: Array) -> Decision:
        hand = Hand.seen(seen)
        skill = skill_towards(hand, seen.achieved, goal)
        return Decision(skill.act(hand, seen.achieved, self._style), skill=skill.name)


def _block_there(achieved: Array, goal: Array, index: int) -> bool:
    at, to = block(achieved, index), block(goal, index)
    off = (direction(at) - direction(to) + np.pi / 2) % np.pi - np.pi / 2
    return bool(np.hypot(*(at[:2] - to[:2])) < 0.025 and abs(at[2] - to[2]) < 0.015 and abs(off) < 0.3)


def _carry(goal: Array, index: int, name: str | None = None) -> Carry:
    pose = block(goal, index)
    resting = in_tray(goal, index) or pose[2] < scene.TABLE_Z + 0.03 or _supported(goal, index)
    position = (float(pose[0]), float(pose[1]), float(pose[2]))
    return Carry(name or f"carry_{BLOCK_NAMES[index]}", index, position, direction(pose), release=resting)


def _supported(goal: Array, index: int) -> bool:
    pose = block(goal, index)
    below = [block(goal, i) for i in range(len(BLOCK_NAMES)) if i != index]
    return any(np.hypot(*(pose[:2] - b[:2])) < 0.045 and 0.025 < pose[2] - b[2] < 0.055 for b in below)
