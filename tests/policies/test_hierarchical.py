"""Laws of acting through subgoals."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.policies import PolicyActor
from playlearn.policies.hierarchical import SubgoalActor
from tests.policies.parts import SPEC, examples, policy


class LowLevel:
    """Believes what it sees, remembers what it is shown, plans every second step."""

    name, cameras, n_action_steps = "low", (), 2

    def __init__(self) -> None:
        self.policy = policy()
        self.shown: list[tuple[int, int, float]] = []  # moment, row, goal

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self.moment, self.seeds = 0, list(seeds)

    def estimate_achieved(self, observations: Sequence[Observation], active: Sequence[bool]) -> Array:
        return np.stack([observation.achieved for observation in observations])

    def show(self, row: int, goal: Goal) -> None:
        self.shown.append((self.moment, row, round(float(goal.achieved[0]), 3)))
        self.last = goal.achieved

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        self.moment += 1
        return [Decision(np.full(2, 0.5, np.float32)) for _ in observations]


class HighLevel:
    """Half of what is left to the goal."""

    name, reads = "high", "state"

    def __init__(self) -> None:
        self.policy = policy("cnn")

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self.goals, self.seeds = goals, list(seeds)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        pairs = zip(self.goals, observations, strict=True)
        return [Decision((goal.achieved - seen.achieved) / 2 if goal else seen.achieved) for goal, seen in pairs]


def seen(*places: float) -> list[Observation]:
    return [Observation(np.zeros(3, np.float32), at(place)) for place in places]


def goals(*places: float) -> list[Goal]:
    return [Goal(at(place)) for place in places]


def at(x: float) -> Array:
    """Red at x, the drawer and the lamp (see SPEC) as they are."""
    return np.array([x, 0.0, 0.0, 0.0], np.float32)


def made(steps: int) -> tuple[SubgoalActor, LowLevel, HighLevel]:
    low, high = LowLevel(), HighLevel()
    parts: list[Any] = [low, high]
    return SubgoalActor(*parts, lambda now, goal: bool(abs(now - goal).max() < 0.01), steps), low, high


def test_a_subgoal_stays_until_it_is_reached_or_its_time_is_over() -> None:
    """Checked when the low-level policy plans, each second step: row 0 gets to 0.5 at step 3, row 1 nowhere."""
    actor, low, _ = made(steps=5)
    actor.reset(goals(1.0, 2.0), [7, 8])
    for place in (0.0, 0.1, 0.2, 0.5, 0.5, 0.6, 0.7):
        decisions = actor.act(seen(place, 0.0), [True, True])
    assert low.shown == [(0, 0, 0.5), (0, 1, 1.0), (4, 0, 0.75), (6, 1, 1.0)]
    np.testing.assert_array_equal(decisions[0].action, [0.5, 0.5])
    actor.reset(goals(1.0, 2.0), [7, 8])
    actor.act(seen(0.0, 0.0), [True, False])
    assert low.shown[4:] == [(0, 0, 0.5)], "it begins anew, and proposes nothing to a row that is over"


@pytest.mark.parametrize("reads", ["state", "image"])
def test_what_is_near_is_asked_for_exactly(reads: str) -> None:
    """In spreads: red is to be 0.2 beside its goal, the drawer 0.2 off where it is, the lamp halfway, 1 from either.

    A high-level policy that gets a goal image does not know the goal pose of red.
    """
    actor, low, high = made(steps=5)
    high.reads = reads
    spread = low.policy.normalizer.get_buffer("achieved_std").numpy()
    goal = spread * np.array([4.0, 0.0, 0.0, 2.0], np.float32)
    change = spread * np.array([4.2, 0.1, 0.2, 1.0], np.float32)
    high.act = lambda observations, active: [Decision(change)]  # type: ignore[method-assign]
    actor.reset([Goal(goal)], [0])
    actor.act(seen(0.0), [True])
    red = [4.0, 0.0] if reads == "state" else [4.2, 0.1]
    np.testing.assert_allclose(low.last / spread, [*red, 0.0, 1.0], rtol=1e-5)


def test_a_proposal_of_nothing_new_is_no_subgoal() -> None:
    """The far goal is shown in its stead, and the next look is soon, though a subgoal would have 50 steps."""
    actor, low, high = made(steps=50)
    high.act = lambda observations, active: [Decision(at(0.0))]  # type: ignore[method-assign]
    actor.reset(goals(1.0), [0])
    for _ in range(4):
        actor.act(seen(0.0), [True])
    assert low.shown == [(0, 0, 1.0), (2, 0, 1.0)]


def test_each_policy_has_noise_of_its_own_and_gets_the_images_it_needs() -> None:
    actor, low, high = made(steps=5)
    actor.reset(goals(1.0, 2.0), [7, 8])
    assert low.seeds == [7, 8], "the low-level policy's is what it would be without a high-level policy"
    assert len({*high.seeds, *low.seeds}) == 4
    assert actor.cameras == ("front", "wrist"), "where a subgoal is due"
    actor.act(seen(0.0, 0.0), [True, True])
    assert actor.cameras == (), "while the low-level policy executes its plan"


def test_a_low_level_policy_whose_goals_hold_the_robots_state_is_refused() -> None:
    low = LowLevel()
    low.policy = policy(encoder_options={"goal_proprio": True})
    parts: list[Any] = [low, HighLevel()]
    with pytest.raises(UsageError, match="goal_proprio"):
        SubgoalActor(*parts, lambda now, goal: False, 5)


def test_a_change_of_goal_is_planned_for_at_once() -> None:
    """Without the change it would plan again at the fourth step alone."""
    rng, actor = np.random.default_rng(0), PolicyActor(policy("state"), n_action_steps=4)
    frames = {camera: np.zeros((*size, 3), np.uint8) for camera, size in SPEC.cameras.items()}

    def look() -> Observation:
        state, achieved = rng.normal(size=len(SPEC.state_names)), rng.normal(size=len(SPEC.achieved_names))
        return Observation(state.astype(np.float32), achieved.astype(np.float32), frames)

    here, there = look(), look()
    actor.reset([Goal(look().achieved)], [0])
    actor.act([here], [True])
    actor.show(0, Goal(there.achieved))
    taken = actor.act([here], [True])[0].action
    actor.reset([Goal(there.achieved)], [0])
    np.testing.assert_array_equal(actor.act([here], [True])[0].action, taken)


def test_what_is_believed_is_seen_where_there_are_cameras() -> None:
    """The state policy is told; the one with cameras reads it off them alone, in the units of the data."""
    told, looking = (
        examples(),
        {"state_supervision": 1.0, "goal": "both", "cameras": ["front"], "goal_camera": "front"},
    )
    assert torch.equal(policy().estimate_achieved(told), told.achieved[:, -1])
    reader = policy("cnn", encoder_options=looking)
    estimate_achieved = reader.estimate_achieved(told)
    assert torch.equal(
        reader.estimate_achieved(dataclasses.replace(told, achieved=told.achieved + 1)), estimate_achieved
    )
    with torch.inference_mode():
        keep = torch.zeros(len(told.state), dtype=torch.bool)
        normal = reader.encoder(reader.normalized(told), keep).observed
    assert normal is not None
    torch.testing.assert_close(reader.normalizer.normalize("achieved", estimate_achieved), normal[:, -1])
    with pytest.raises(UsageError, match="makes no pose estimates"):
        policy("cnn", encoder_options={**looking, "state_supervision": 0.0}).estimate_achieved(told)
