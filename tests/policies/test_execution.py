"""Laws of chunk execution."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch

from playlearn.batch import Inputs
from playlearn.episode import Goal, Observation
from playlearn.errors import UsageError
from playlearn.policies import PolicyActor
from tests.policies.parts import SPEC, A, G, H, S, policy


class Counting:
    """Stands in for a policy: chunk[h] is 0.01 (number of the plan) + 0.001 h, whatever it sees."""

    def __init__(self) -> None:
        made = policy()
        self.config, self.spec, self.cameras, self.head = made.config, made.spec, made.cameras, made.head
        self.plans = 0
        self.seen: list[Inputs] = []

    def eval(self) -> "Counting":
        return self

    def act(self, inputs: Inputs, generators: Sequence[torch.Generator], guidance: float | None) -> torch.Tensor:
        self.plans += 1
        self.seen.append(inputs)
        steps = 0.01 * self.plans + 0.001 * torch.arange(H)
        return steps[None, :, None].expand(len(inputs.state), H, A).clone()


def observation(rng: np.random.Generator) -> Observation:
    frames = {camera: rng.integers(0, 256, (*size, 3), dtype=np.uint8) for camera, size in SPEC.cameras.items()}
    return Observation(rng.normal(size=S).astype(np.float32), rng.normal(size=G).astype(np.float32), frames)


def goal(rng: np.random.Generator) -> Goal:
    seen = observation(rng)
    return Goal(seen.achieved, seen.images)


def drive(actor: PolicyActor, steps: int, rows: int = 1) -> np.ndarray:
    rng = np.random.default_rng(0)
    actor.reset([goal(rng) for _ in range(rows)], list(range(rows)))
    actions = []
    for _ in range(steps):
        decisions = actor.act([observation(rng) for _ in range(rows)], [True] * rows)
        actions.append([decision.action for decision in decisions])
    return np.array(actions)  # (steps, rows, A)


def stand_in() -> Any:
    return Counting()


def test_what_is_executed_lies_within_the_environments_bounds() -> None:
    """The play that the policy learned from may have known none; an action without bounds is left as it is."""
    bounds = ((-1.0, 0.0105), (0.02, 1.0), None)
    taken = drive(PolicyActor(stand_in(), n_action_steps=2, bounds=bounds), 2)[:, 0]
    np.testing.assert_allclose(taken, [[0.01, 0.02, 0.01], [0.0105, 0.02, 0.011]], rtol=1e-6)


def test_a_few_actions_of_each_chunk_are_executed() -> None:
    taken = drive(PolicyActor(stand_in(), n_action_steps=2), 5)[:, 0, 0]
    np.testing.assert_allclose(taken, [0.010, 0.011, 0.020, 0.021, 0.030], atol=1e-6)


def test_ensembling_averages_all_plans_for_a_moment() -> None:
    """At moment 1 the first plan says 0.011 (weight 1, the oldest), the second 0.020 (weight exp(-0.5))."""
    taken = drive(PolicyActor(stand_in(), n_action_steps=4, ensemble=0.5), 2)[:, 0, 0]
    weight = np.exp(-0.5)
    np.testing.assert_allclose(taken, [0.010, (0.011 + weight * 0.020) / (1 + weight)], atol=1e-6)


def test_a_history_begins_by_repeating_its_first_observation() -> None:
    counting = stand_in()
    counting.config = policy(history=3).config
    drive(PolicyActor(counting, n_action_steps=1), 4)
    masks = [inputs.history_mask[0].tolist() for inputs in counting.seen]
    assert masks == [[False, False, True], [False, True, True], [True, True, True], [True, True, True]]
    first, last = counting.seen[0].state[0], counting.seen[3].state[0]
    assert torch.equal(first[0], first[2])
    assert torch.equal(counting.seen[2].state[0, 1:], last[:2]), "a history moves on by one observation a step"


@pytest.mark.parametrize("encoder", ["state", "cnn"])
def test_what_one_environment_gets_does_not_depend_on_the_others(encoder: str) -> None:
    """Row 0 with a companion that stops early gets the bits it gets with one that goes on."""
    actor = PolicyActor(policy(encoder, head="diffusion", history=2), n_action_steps=2)

    def row_zero(companion_runs: int, companion_seed: int) -> np.ndarray:
        mine, theirs = np.random.default_rng(0), np.random.default_rng(companion_seed)
        actor.reset([goal(mine), goal(theirs)], [10, companion_seed])
        return np.array(
            [
                actor.act([observation(mine), observation(theirs)], [True, step < companion_runs])[0].action
                for step in range(6)
            ]
        )

    alone = row_zero(0, 1)
    assert np.array_equal(alone, row_zero(6, 1))
    assert np.array_equal(alone, row_zero(3, 2))
    assert len(np.unique(alone[:, 0])) > 2


def test_an_episode_is_a_function_of_its_seed() -> None:
    actor = PolicyActor(policy(head="diffusion"), n_action_steps=2)
    first = drive(actor, 4, rows=2)
    assert np.array_equal(first, drive(actor, 4, rows=2))
    rng = np.random.default_rng(0)
    same = goal(rng)
    actor.reset([same, same], [1, 2])
    seen = observation(rng)
    one, two = actor.act([seen, seen], [True, True])
    assert not np.array_equal(one.action, two.action), "another seed must draw another chunk"


def test_plans_reuse_their_noise_for_as_long_as_the_head_asks() -> None:
    """The same is seen at every step, so only the noise can change what is done: here with every third chunk."""
    made = policy(head="diffusion")
    made.head.noise_repeat = 3
    actor, rng = PolicyActor(made, n_action_steps=1), np.random.default_rng(0)
    actor.reset([goal(rng)], [0])
    seen = observation(rng)
    done = [tuple(actor.act([seen], [True])[0].action.tolist()) for _ in range(9)]
    assert [done.index(action) for action in done] == [0, 0, 0, 3, 3, 3, 6, 6, 6]


@pytest.mark.parametrize("history", [1, 3])
def test_what_it_does_not_ask_to_see_changes_nothing(history: int) -> None:
    """Two rows, of which the second ends at step 3, between two plans: with all frames, and with those asked for."""

    def actions(*, hide: bool) -> tuple[list[list[float]], list[tuple[str, ...]]]:
        rng, actor = (
            np.random.default_rng(0),
            PolicyActor(policy("cnn", head="flow", history=history), n_action_steps=4),
        )
        actor.reset([goal(rng), goal(rng)], [0, 1])
        taken, asked = [], []
        for step in range(9):
            asked.append(actor.cameras)
            now = [observation(rng), observation(rng)]
            if hide:
                now = [Observation(o.state, o.achieved, {c: o.images[c] for c in actor.cameras}) for o in now]
            taken.append(actor.act(now, [True, step < 3])[0].action.tolist())
        return taken, asked

    seen, asked = actions(hide=True)
    both = ("front", "wrist")
    assert asked == [both if history > 1 or step % 4 == 0 else () for step in range(9)]
    assert seen == actions(hide=False)[0]


def test_goals_and_settings_are_checked() -> None:
    with pytest.raises(UsageError, match="between 1 and the policy's chunk of 4, got 5"):
        PolicyActor(policy(), n_action_steps=5)
    actor = PolicyActor(policy("cnn"), n_action_steps=2)
    with pytest.raises(UsageError, match="'front' image, and there is none"):
        actor.reset([Goal(np.zeros(G, np.float32))], [0])
    with pytest.raises(UsageError, match="needs a goal"):
        PolicyActor(policy(), n_action_steps=2).reset([None], [0])
    assert actor.cameras == ("front", "wrist")
    assert PolicyActor(policy(), n_action_steps=2).cameras == ()
