"""Why an attempt failed, read from what every world gives: `achieved`, the robot's state, the world's tolerances."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.evaluation.objects import misplaced
from playlearn.layout import ObjectLayout
from playlearn.relabeling import SettlingConfig
from playlearn.relabeling.robot import RobotConfig
from playlearn.relabeling.settling import thresholds
from playlearn.sim.environment import Environment

ENDED, LEFT, NEAR, WRONG = "ended early", "reached then left", "timed out near", "wrong object moved"
DROPPED, MISSED, STALLED = "dropped", "missed grasp", "stalled"
NEVER, SHORT = "never moved the right object", "moved, but not there"
FAILURE_MODES = {
    ENDED: "the world ended the attempt, or it crashed",
    LEFT: "everything asked for was there once, and did not stay",
    NEAR: "what was to be moved was, and is almost where it is shown",
    WRONG: "something else was moved, or disturbed, and not what was to be",
    DROPPED: "what was to be moved went with the closed gripper, and was let go or lost elsewhere",
    MISSED: "the gripper closed beside what was to be moved, which never went with it",
    STALLED: "hand and gripper hardly moved from some moment to the end; none of the above",
    NEVER: "what was to be moved did not, and the gripper never closed beside it",
    SHORT: "what was to be moved was, without a grasp or still in it, and is elsewhere",
}


@dataclass(frozen=True)
class FailureModesConfig:
    """What the words mean; meters and seconds.

    reach: how near the hand must be for its closing to be a grasp at something. near: off by at most so many of the
    world's tolerances. still, still_seconds: within what the hand stays, and for how long at least before the end,
    where it has stalled. opens: by how much the gripper closes or opens before it has, or by a quarter of how far it
    went in the attempt if that is more. settling: its `change` says when something has moved. robot: which numbers
    are the hand's place and the gripper's opening.
    """

    reach: float = 0.06
    near: float = 1.5
    still: float = 0.02
    still_seconds: float = 2.0
    opens: float = 0.008
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)


@dataclass(frozen=True)
class FailureReport:
    """failure_mode: one of `FAILURE_MODES`.

    asked: the things that were to be moved and are not there. stalled_from: seconds into the
    attempt, None where the hand moved to the end. closest: meters, of the hand to one of them, None where they have no
    place. grasps, caught: how often the gripper closed beside one, and how often that then went with it. off: meters,
    of the hand to it at the best of these closings. holding: one was still in the gripper at the end.
    """

    failure_mode: str
    asked: tuple[str, ...]
    stalled_from: float | None
    closest: float | None
    grasps: int
    caught: int
    off: float | None
    holding: bool


def classify_failure(
    env: Environment,
    achieved: Array,
    proprio: Array,
    goal: Array,
    content: NDArray[np.bool_],
    ended: bool,
    config: FailureModesConfig,
    grasping: bool = True,
) -> FailureReport:
    """Of a failed attempt with achieved (T+1, G) and body (T+1, S) towards goal (G,).

    content: (T+1,) whether the judge was. ended: whether it was over before its time. grasping: whether it
    is to be done by a grasp, so that it can fail as one.
    """
    names = env.spec.achieved_names
    own = ObjectLayout(names).objects()
    change = thresholds(config.settling.change, names, "change")
    start, final = achieved[0].astype(np.float64), achieved[-1].astype(np.float64)
    goal = goal.astype(np.float64)
    meant = _meant(env, start, goal, change)
    amiss = misplaced(env, final, goal)
    asked = [thing for thing in own if thing in meant and thing in amiss] or [thing for thing in own if thing in meant]
    moved = {thing for thing, k in own.items() if (np.abs(achieved - start)[:, k] > change[k]).any()}
    hand = _Hand.of(env, proprio, config)
    grasps = [grasp for thing in asked for grasp in hand.grasps(achieved, names, own[thing], change)]
    caught = [grasp for grasp in grasps if grasp.followed]
    holding = any(grasp.end == len(achieved) for grasp in caught)
    stalled = hand.stalled(config)
    closest = [near for thing in asked if (near := hand.closest(achieved, names, own[thing])) is not None]

    def failure_mode() -> str:
        if ended:
            return ENDED
        if content.any():
            return LEFT
        touched = bool(moved & set(asked))
        if touched and not set(misplaced(env, final, goal, config.near)) & meant:
            return WRONG if set(amiss) - meant else NEAR
        if not touched and moved - meant:
            return WRONG
        if grasping and caught and not holding:
            return DROPPED
        if grasping and grasps and not caught:
            return MISSED
        if stalled is not None:
            return STALLED
        return SHORT if touched else NEVER

    return FailureReport(
        failure_mode=failure_mode(),
        asked=tuple(asked),
        stalled_from=None if stalled is None else stalled / env.spec.fps,
        closest=min(closest, default=None),
        grasps=len(grasps),
        caught=len(caught),
        off=min((grasp.off for grasp in grasps), default=None),
        holding=holding,
    )


def by_grasp(env: Environment, achieved: Array, proprio: Array, goal: Array, config: FailureModesConfig) -> bool:
    """Whether in this attempt, a successful one, something that was to be moved went with the closed gripper."""
    names = env.spec.achieved_names
    change = thresholds(config.settling.change, names, "change")
    hand, own = _Hand.of(env, proprio, config), ObjectLayout(names).objects()
    meant = _meant(env, achieved[0].astype(np.float64), goal.astype(np.float64), change)
    return any(grasp.followed for thing in meant for grasp in hand.grasps(achieved, names, own[thing], change))


def _meant(env: Environment, start: Array, goal: Array, change: Array) -> set[str]:
    """The things that the goal shows elsewhere."""
    own = ObjectLayout(env.spec.achieved_names).objects()
    return {thing for thing, k in own.items() if (np.abs(goal - start)[k] > change[k]).any()} | set(
        misplaced(env, start, goal)
    )


@dataclass(frozen=True)
class _Grasp:
    """end: the first observation with the gripper open again, T+1 where it never is. followed: the thing went along.

    off: meters between hand and thing when it closed.
    """

    end: int
    followed: bool
    off: float


@dataclass(frozen=True, eq=False)
class _Hand:
    """place (T+1, d) m along the axes named in `axes`. closings: (first closed, first open again) observations."""

    place: Array
    axes: tuple[str, ...]
    opening: Array
    closings: tuple[tuple[int, int], ...]
    fps: float
    reach: float

    @classmethod
    def of(cls, env: Environment, proprio: Array, config: FailureModesConfig) -> "_Hand":
        names = env.spec.state_names
        gripper, arm = config.robot.columns(names)
        opening = proprio[:, gripper[0]].astype(np.float64) if gripper else np.zeros(len(proprio))
        axes = ObjectLayout([names[k] for k in arm]).quantities
        opens = max(config.opens, np.ptp(opening) / 4)
        closings = tuple(_closings(opening.tolist(), opens))
        return cls(proprio[:, arm].astype(np.float64), axes, opening, closings, env.spec.fps, config.reach)

    def _beside(self, achieved: Array, names: Sequence[str], columns: Sequence[int]) -> tuple[Array, Array] | None:
        """(T+1, d) of the hand and of the thing along the axes that both have; None where there are none."""
        axes = ObjectLayout(names).quantities
        shared = [(self.axes.index(axes[k]), k) for k in columns if axes[k] in self.axes]
        if not shared:
            return None
        mine, its = zip(*shared, strict=True)
        return self.place[:, mine], achieved[:, its].astype(np.float64)

    def closest(self, achieved: Array, names: Sequence[str], columns: Sequence[int]) -> float | None:
        """Meters between hand and thing at their nearest."""
        both = self._beside(achieved, names, columns)
        return None if both is None else float(np.linalg.norm(both[0] - both[1], axis=1).min())

    def grasps(self, achieved: Array, names: Sequence[str], columns: Sequence[int], change: Array) -> list[_Grasp]:
        """The closings at a thing; it followed where it moved, and the hand beside it with it."""
        both = self._beside(achieved, names, columns)
        if both is None:
            return []
        hand, thing = both
        axes = ObjectLayout(names).quantities
        moves = max(change[k] for k in columns if axes[k] in self.axes)
        found = []
        for begin, end in self.closings:
            closing = slice(max(0, begin - 1), min(end, begin + round(self.fps / 4)) + 1)
            off = float(np.linalg.norm(hand[closing] - thing[closing], axis=1).min())
            if off > self.reach:
                continue
            went = np.linalg.norm(thing[begin : end + 1] - thing[begin], axis=1)
            apart = np.linalg.norm((thing - hand)[begin : end + 1] - (thing - hand)[begin], axis=1)
            found.append(_Grasp(end, bool(((went > moves) & (apart < went / 2)).any()), off))
        return found

    def stalled(self, config: FailureModesConfig) -> int | None:
        """The observation from which on hand and gripper hardly moved, None where that is not long enough ago."""
        far = np.linalg.norm(self.place - self.place[-1], axis=1) > config.still
        far |= np.abs(self.opening - self.opening[-1]) > max(config.opens, np.ptp(self.opening) / 4)
        since = int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0
        return since if len(far) - 1 - since >= config.still_seconds * self.fps else None


def _closings(opening: Sequence[float], opens: float) -> list[tuple[int, int]]:
    """(first closed, first open again) of each time that the gripper closed by `opens` from its widest."""
    closed, furthest, begin, found = False, opening[0], 0, []
    for t, now in enumerate(opening):
        furthest = min(furthest, now) if closed else max(furthest, now)
        if abs(now - furthest) > opens:
            if closed:
                found.append((begin, t))
            closed, furthest, begin = not closed, now, t
    return [*found, (begin, len(opening))] if closed else found
