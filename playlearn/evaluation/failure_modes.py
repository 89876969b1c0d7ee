"""Why an attempt failed, read from `achieved`, the robot's state and the environment's tolerances alone."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.evaluation.objects import misplaced
from playlearn.layout import ObjectLayout
from playlearn.quantity import difference
from playlearn.relabeling import SettlingConfig
from playlearn.relabeling.robot import RobotConfig
from playlearn.relabeling.settling import thresholds
from playlearn.sim.environment import Environment

ENDED, LEFT, NEAR, WRONG = "ended early", "reached then left", "timed out near", "wrong object moved"
DROPPED, MISSED, STALLED = "dropped", "missed grasp", "stalled"
NEVER, SHORT = "never moved the right object", "moved, but not there"
FAILURE_MODES = {
    ENDED: "the environment ended the episode, or the rollout crashed",
    LEFT: "success was reached once, and not held",
    NEAR: "the target objects were moved, and are almost at their goal",
    WRONG: "another object was moved or disturbed, and not the target",
    DROPPED: "a target object was grasped, and let go or lost elsewhere",
    MISSED: "the gripper closed beside a target object, which never moved with it",
    STALLED: "end effector and gripper hardly moved from some moment to the end; none of the above",
    NEVER: "no target object moved, and the gripper never closed beside one",
    SHORT: "a target object was moved, without a grasp or still in it, and is elsewhere",
}


@dataclass(frozen=True)
class FailureModesConfig:
    """Thresholds of the failure modes; meters and seconds.

    grasp_radius: a closing of the gripper within this distance of an object is an attempt to grasp it.
    near_tolerances: "timed out near" is within so many of the environment's tolerances.
    stall_radius: the end effector has stalled if it stays within this distance of its last position ...
    stall_seconds: ... for at least so long before the end.
    opening_change: the gripper closes or opens if its opening changes by this much, or by a quarter of its range in
        the episode if that is more.
    settling: `change` is the threshold of an object's movement.
    robot: which dimensions of the state are the end effector's position and the gripper's opening.
    """

    grasp_radius: float = 0.06
    near_tolerances: float = 1.5
    stall_radius: float = 0.02
    stall_seconds: float = 2.0
    opening_change: float = 0.008
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)


@dataclass(frozen=True)
class FailureReport:
    """Why one attempt failed.

    failure_mode: one of `FAILURE_MODES`.
    targets: the objects that the goal changes and that are not there.
    stalled_from: seconds into the attempt; None if the end effector moved to the end.
    min_distance: meters from the end effector to the nearest target; None if targets have no position.
    grasp_attempts: how often the gripper closed beside a target.
    grasps_held: how often the target then moved with the gripper.
    grasp_distance: meters from the end effector to the target at the best closing; None without a closing.
    holding: a target was in the gripper at the end.
    """

    failure_mode: str
    targets: tuple[str, ...]
    stalled_from: float | None
    min_distance: float | None
    grasp_attempts: int
    grasps_held: int
    grasp_distance: float | None
    holding: bool


def classify_failure(
    env: Environment,
    achieved: Array,
    proprio: Array,
    goal: Array,
    success: NDArray[np.bool_],
    ended: bool,
    config: FailureModesConfig,
    needs_grasp: bool = True,
) -> FailureReport:
    """Classify a failed attempt with achieved (T+1, G) and proprio (T+1, S) towards goal (G,).

    success: (T+1,) whether the judge was satisfied.
    ended: whether the episode ended before its time.
    needs_grasp: whether the goal is reached by a grasp, so that a grasp can fail.
    """
    names = env.spec.achieved_names
    columns = ObjectLayout(names).objects()
    change = _change(env, config)
    start, final = achieved[0].astype(np.float64), achieved[-1].astype(np.float64)
    goal = goal.astype(np.float64)
    to_change = _changed_objects(env, start, goal, change)
    off = misplaced(env, final, goal)
    targets = [name for name in columns if name in to_change and name in off] or [
        name for name in columns if name in to_change
    ]
    moved = {name for name, k in columns.items() if (_apart(env, achieved, start)[:, k] > change[k]).any()}
    effector = _EndEffector.of(env, proprio, config)
    grasps = [grasp for name in targets for grasp in effector.grasps(achieved, names, columns[name], change)]
    held = [grasp for grasp in grasps if grasp.held]
    holding = any(grasp.end == len(achieved) for grasp in held)
    stalled = effector.stalled(config)
    distances = [
        near for name in targets if (near := effector.min_distance(achieved, names, columns[name])) is not None
    ]

    def failure_mode() -> str:
        if ended:
            return ENDED
        if success.any():
            return LEFT
        touched = bool(moved & set(targets))
        if touched and not set(misplaced(env, final, goal, config.near_tolerances)) & to_change:
            return WRONG if set(off) - to_change else NEAR
        if not touched and moved - to_change:
            return WRONG
        if needs_grasp and held and not holding:
            return DROPPED
        if needs_grasp and grasps and not held:
            return MISSED
        if stalled is not None:
            return STALLED
        return SHORT if touched else NEVER

    return FailureReport(
        failure_mode=failure_mode(),
        targets=tuple(targets),
        stalled_from=None if stalled is None else stalled / env.spec.fps,
        min_distance=min(distances, default=None),
        grasp_attempts=len(grasps),
        grasps_held=len(held),
        grasp_distance=min((grasp.distance for grasp in grasps), default=None),
        holding=holding,
    )


def uses_grasp(env: Environment, achieved: Array, proprio: Array, goal: Array, config: FailureModesConfig) -> bool:
    """Whether in this successful attempt a target object moved with the closed gripper."""
    names = env.spec.achieved_names
    change = _change(env, config)
    effector, columns = _EndEffector.of(env, proprio, config), ObjectLayout(names).objects()
    targets = _changed_objects(env, achieved[0].astype(np.float64), goal.astype(np.float64), change)
    return any(grasp.held for name in targets for grasp in effector.grasps(achieved, names, columns[name], change))


def _change(env: Environment, config: FailureModesConfig) -> Array:
    """(G,) how far each dimension moves before it has changed."""
    names = env.spec.achieved_names
    return thresholds(config.settling.change, names, env.spec.quantities.of("achieved", len(names)), "change")


def _apart(env: Environment, one: Array, other: Array) -> Array:
    """(..., G) how far two sets of achieved goals are apart."""
    return np.asarray(np.abs(difference(one, other, env.spec.quantities.achieved)))


def _changed_objects(env: Environment, start: Array, goal: Array, change: Array) -> set[str]:
    """The objects that the goal shows elsewhere."""
    columns = ObjectLayout(env.spec.achieved_names).objects()
    return {name for name, k in columns.items() if (_apart(env, goal, start)[k] > change[k]).any()} | set(
        misplaced(env, start, goal)
    )


@dataclass(frozen=True)
class _Grasp:
    """One closing of the gripper beside an object.

    end: the first observation with the gripper open again; T+1 if it stays closed.
    held: the object moved with the gripper.
    distance: meters from the end effector to the object when it closed.
    """

    end: int
    held: bool
    distance: float


@dataclass(frozen=True, eq=False)
class _EndEffector:
    """Movement of end effector and gripper in one attempt.

    position: (T+1, d) m along the axes named in `axes`.
    axes: names.
    opening: (T+1,) of the gripper.
    closings: (first closed, first open again) observations.
    fps: control steps a second.
    grasp_radius: see `FailureModesConfig`.
    """

    position: Array
    axes: tuple[str, ...]
    opening: Array
    closings: tuple[tuple[int, int], ...]
    fps: float
    grasp_radius: float

    @classmethod
    def of(cls, env: Environment, proprio: Array, config: FailureModesConfig) -> "_EndEffector":
        names = env.spec.state_names
        gripper, arm = config.robot.columns(names)
        opening = proprio[:, gripper[0]].astype(np.float64) if gripper else np.zeros(len(proprio))
        axes = ObjectLayout([names[k] for k in arm]).axes
        opening_change = max(config.opening_change, np.ptp(opening) / 4)
        closings = tuple(_closings(opening.tolist(), opening_change))
        return cls(proprio[:, arm].astype(np.float64), axes, opening, closings, env.spec.fps, config.grasp_radius)

    def _positions(self, achieved: Array, names: Sequence[str], columns: Sequence[int]) -> tuple[Array, Array] | None:
        """(T+1, d) of end effector and object along their common axes; None without a common axis."""
        axes = ObjectLayout(names).axes
        shared = [(self.axes.index(axes[k]), k) for k in columns if axes[k] in self.axes]
        if not shared:
            return None
        own, others = zip(*shared, strict=True)
        return self.position[:, own], achieved[:, others].astype(np.float64)

    def min_distance(self, achieved: Array, names: Sequence[str], columns: Sequence[int]) -> float | None:
        """Smallest distance between end effector and object, in meters."""
        positions = self._positions(achieved, names, columns)
        return None if positions is None else float(np.linalg.norm(positions[0] - positions[1], axis=1).min())

    def grasps(self, achieved: Array, names: Sequence[str], columns: Sequence[int], change: Array) -> list[_Grasp]:
        """The closings beside an object; it is held if it moves, and the end effector moves with it."""
        positions = self._positions(achieved, names, columns)
        if positions is None:
            return []
        effector, target = positions
        axes = ObjectLayout(names).axes
        threshold = max(change[k] for k in columns if axes[k] in self.axes)
        found = []
        for begin, end in self.closings:
            closing = slice(max(0, begin - 1), min(end, begin + round(self.fps / 4)) + 1)
            distance = float(np.linalg.norm(effector[closing] - target[closing], axis=1).min())
            if distance > self.grasp_radius:
                continue
            moved = np.linalg.norm(target[begin : end + 1] - target[begin], axis=1)
            relative = np.linalg.norm((target - effector)[begin : end + 1] - (target - effector)[begin], axis=1)
            found.append(_Grasp(end, bool(((moved > threshold) & (relative < moved / 2)).any()), distance))
        return found

    def stalled(self, config: FailureModesConfig) -> int | None:
        """The observation after which end effector and gripper hardly moved; None if that is not long enough."""
        moving = np.linalg.norm(self.position - self.position[-1], axis=1) > config.stall_radius
        opening_change = max(config.opening_change, np.ptp(self.opening) / 4)
        moving |= np.abs(self.opening - self.opening[-1]) > opening_change
        since = int(np.flatnonzero(moving)[-1]) + 1 if moving.any() else 0
        return since if len(moving) - 1 - since >= config.stall_seconds * self.fps else None


def _closings(opening: Sequence[float], opening_change: float) -> list[tuple[int, int]]:
    """(first closed, first open again) of each time that the gripper closed by `opening_change` from its widest."""
    closed, furthest, begin, found = False, opening[0], 0, []
    for t, now in enumerate(opening):
        furthest = min(furthest, now) if closed else max(furthest, now)
        if abs(now - furthest) > opening_change:
            if closed:
                found.append((begin, t))
            closed, furthest, begin = not closed, now, t
    return [*found, (begin, len(opening))] if closed else found
