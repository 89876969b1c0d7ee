"""Each failure mode, by a scripted actor in the point environment that fails in that way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.evaluation import failure_modes
from playlearn.evaluation.failure_modes import FailureModesConfig, FailureReport, classify_failure, uses_grasp
from playlearn.rollout import rollout
from playlearn.sim.environment import Environment, EnvironmentConfig
from tests.fakes import BUTTON, PointConfig, PointEnv, PointExpert

# A point's stride is 10 cm, so hands are large here; its closed grip reads 0, as an opening should.
CONFIG = FailureModesConfig(grasp_radius=0.2, stall_radius=0.05, stall_seconds=1.0)
START = np.array([0.0, -0.5, -0.5, 0.0, 0.3, 0.0, 0.0, 0.0])  # hand at (-0.5, -0.5), open; puck at (0.3, 0); lamp off
GOAL = np.array([-0.4, 0.4, 0.0])  # the puck elsewhere, the lamp as it is
FAR_OFF = np.array([-1.0, -1.0])
HOLD = 3


@EnvironmentConfig.register_subclass("point_hand")
@dataclass(frozen=True)
class HandConfig(PointConfig):
    def build(self) -> "CorrectableEnv":
        return CorrectableEnv(self)


class CorrectableEnv(PointEnv):
    """The point environment with the state names of a robot arm."""

    spec = replace(PointEnv.spec, state_names=("eef.x", "eef.y", "gripper.opening"))

    def observe(self, cameras: Sequence[str] = ()) -> Observation:
        seen = super().observe(cameras)
        state = np.array([*seen.state[:2], 1.0 - seen.state[2]], np.float32)
        return Observation(state, seen.achieved, seen.images, seen.time)


class HandExpert(PointExpert):
    """The point environment's expert, with these state names."""

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        return super().act([replace(o, state=np.array([*o.state[:2], 1.0 - o.state[2]])) for o in observations], active)


def hand_expert(_environment: Environment) -> HandExpert:
    return HandExpert()


Stop = tuple[Any, float]  # where to, (2,) or "puck"; grip


@dataclass
class Script:
    """Moves from stop to stop; then back and forth between the last two, or stays."""

    stops: list[Stop]
    wander: bool = True
    name: str = "script"
    cameras: tuple[str, ...] = ()
    at: int = field(default=0)

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self.at = 0

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        hand, puck = observations[0].state[:2], observations[0].achieved[:2]
        place, grip = self.stops[min(self.at, len(self.stops) - 1)]
        target = puck if isinstance(place, str) else np.asarray(place)
        if np.linalg.norm(target - hand) < 0.02 and (grip <= 0) == (observations[0].state[2] > 0.5):
            self.at += 1
            if self.at >= len(self.stops) and self.wander:
                self.at -= 2
            place, grip = self.stops[min(self.at, len(self.stops) - 1)]
            target = puck if isinstance(place, str) else np.asarray(place)
        delta = np.clip((target - hand) / 0.1, -1, 1)
        near = np.linalg.norm(target - hand) < 0.02
        # the grip changes where it is to be, not on the way there
        closed = grip if near or grip <= 0 else float(observations[0].state[2] < 0.5)
        return [Decision(np.array([*delta, closed], np.float32))]


def found(script: Script, steps: int = 60, goal: Array = GOAL) -> FailureReport:
    env = CorrectableEnv(HandConfig())
    env.set_state(START)
    shown = Goal(np.asarray(goal, np.float32))
    outcome = rollout([env], script, [shown], seeds=[0], max_steps=steps)[0]
    assert outcome.episode is not None
    achieved = outcome.episode.achieved
    success = np.array([env.reached(row, goal) for row in achieved])
    lasted = np.convolve(success, np.ones(HOLD), "valid").max() >= HOLD
    assert not lasted, "this script is to fail"
    return classify_failure(env, achieved, outcome.episode.state, goal, success, outcome.ended != "length", CONFIG)


def grasp() -> list[Stop]:
    return [("puck", -1.0), ("puck", 1.0)]


WANDER: list[Stop] = [((-0.9, -0.9), -1.0), ((-0.2, -0.9), -1.0)]
BESIDE = (0.3, -0.15)  # 15 cm from the puck, which is beyond its grip's reach of 12 cm
CASES: dict[str, tuple[Callable[[], Script], Array]] = {
    failure_modes.NEVER: (lambda: Script(WANDER), GOAL),
    failure_modes.STALLED: (lambda: Script([((0.3, 0.15), -1.0)], wander=False), GOAL),
    failure_modes.MISSED: (lambda: Script([(BESIDE, -1.0), (BESIDE, 1.0), *WANDER]), GOAL),
    failure_modes.DROPPED: (lambda: Script([*grasp(), ((0.3, -0.5), 1.0), ((0.3, -0.5), -1.0), *WANDER]), GOAL),
    failure_modes.SHORT: (lambda: Script([*grasp(), ((0.6, 0.4), 1.0), ((0.6, -0.4), 1.0)]), GOAL),
    failure_modes.NEAR: (lambda: Script([*grasp(), ((-0.33, 0.4), 1.0), ((-0.33, 0.4), -1.0), *WANDER]), GOAL),
    failure_modes.LEFT: (lambda: Script([*grasp(), (GOAL[:2], 1.0), ((-0.7, 0.1), 1.0), ((-0.7, -0.4), 1.0)]), GOAL),
    failure_modes.WRONG: (lambda: Script([(BUTTON, -1.0), (BUTTON, 1.0), *WANDER]), GOAL),
    failure_modes.ENDED: (lambda: Script([*grasp(), ((1.15, 0.0), 1.0), (FAR_OFF, 1.0)]), GOAL),
}


@pytest.mark.parametrize("failure_mode", failure_modes.FAILURE_MODES)
def test_each_failure_mode_is_recognized(failure_mode: str) -> None:
    """All registered modes, so that none lacks an actor that fails in that way."""
    script, goal = CASES[failure_mode]
    result = found(script(), goal=goal)
    assert result.failure_mode == failure_mode
    assert result.targets == ("puck",)
    assert (result.stalled_from is not None) == (failure_mode == failure_modes.STALLED)


def test_what_is_measured_beside_the_mode() -> None:
    """Attempted and successful grasps of the puck, the smallest distance, and when the end effector stopped."""
    dropped, missed, stalled = (
        found(CASES[c][0]()) for c in (failure_modes.DROPPED, failure_modes.MISSED, failure_modes.STALLED)
    )
    assert (dropped.grasp_attempts, dropped.grasps_held, dropped.holding) == (1, 1, False)
    assert (missed.grasp_attempts, missed.grasps_held) == (1, 0)
    assert missed.grasp_distance == pytest.approx(0.15, abs=0.01)
    assert found(CASES[failure_modes.SHORT][0]()).holding
    assert stalled.min_distance == pytest.approx(0.15, abs=0.01)
    # 0.8 m along x at 1 m/s; it is within 5 cm of where it stays half a step before
    assert stalled.stalled_from == pytest.approx(0.8, abs=0.11)


def test_a_pause_is_no_stall() -> None:
    """It is one only if it lasts to the end, and long enough."""
    script, _ = CASES[failure_modes.STALLED]
    assert found(script(), steps=16).failure_mode == failure_modes.NEVER, "0.8 s of rest where 1 s is asked"
    assert found(script(), steps=20).failure_mode == failure_modes.STALLED


def test_a_closing_elsewhere_is_no_missed_grasp() -> None:
    """With a smaller grasp radius, the closing of the missed grasp is no attempt at the puck."""
    env = CorrectableEnv(HandConfig())
    env.set_state(START)
    script = CASES[failure_modes.MISSED][0]()
    episode = rollout([env], script, [Goal(np.asarray(GOAL, np.float32))], seeds=[0], max_steps=60)[0].episode
    assert episode is not None
    quiet = np.zeros(len(episode.achieved), np.bool_)
    close = replace(CONFIG, grasp_radius=0.1)
    assert (
        classify_failure(env, episode.achieved, episode.state, GOAL, quiet, False, close).failure_mode
        == failure_modes.NEVER
    )


def test_only_the_misplaced_object_is_a_target() -> None:
    """The lamp is lit as shown; the failure is that of the puck, and the lamp is no wrong object."""
    goal = np.array([*GOAL[:2], 1.0])
    result = found(Script([(BUTTON, -1.0), (BUTTON, 1.0), *WANDER]), goal=goal)
    assert (result.failure_mode, result.targets) == (failure_modes.NEVER, ("puck",))


def test_a_goal_without_a_grasp_has_no_failed_grasp() -> None:
    """The expert carries the puck and presses the lamp's button; only where it grasped can a grasp be missed."""
    env = CorrectableEnv(HandConfig())
    for goal, grasped in ((GOAL, True), (np.array([0.3, 0.0, 1.0]), False)):
        env.set_state(START)
        shown = [Goal(np.asarray(goal, np.float32))]
        episode = rollout([env], HandExpert(), shown, seeds=[0], max_steps=40)[0].episode
        assert episode is not None
        assert env.reached(episode.achieved[-1], goal)
        assert uses_grasp(env, episode.achieved, episode.state, goal, CONFIG) == grasped
    env.set_state(START)
    script = CASES[failure_modes.MISSED][0]()
    episode = rollout([env], script, [Goal(np.asarray(GOAL, np.float32))], seeds=[0], max_steps=60)[0].episode
    assert episode is not None
    quiet = np.zeros(len(episode.achieved), np.bool_)
    given = (env, episode.achieved, episode.state, GOAL, quiet, False, CONFIG)
    assert [classify_failure(*given, needs_grasp=g).failure_mode for g in (True, False)] == [
        failure_modes.MISSED,
        failure_modes.NEVER,
    ]
