"""Laws of policy and expert at one hand: who acts, what is the label, when a gate opens."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from playlearn.config import from_dict
from playlearn.dagger import DaggerConfig
from playlearn.dagger.actor import DaggerActor, InterventionRule
from playlearn.dagger.gate import DistanceConfig, Gate, GateConfig, GateSignal, NoGateConfig, UncertaintyConfig
from playlearn.dagger.schedule import BetaConfig, ConstantConfig, ExponentialConfig, LinearConfig, ZeroConfig
from playlearn.episode import Array, Decision, Episode, Goal, Observation
from playlearn.errors import UsageError
from playlearn.policies import PolicyConfig
from playlearn.policies.execution import PolicyActor
from playlearn.policies.heads import DiffusionConfig
from playlearn.rollout import RandomActor, rollout
from tests.evaluation.parts import spec
from tests.fakes import PointConfig, PointEnv, PointExpert

torch.set_num_threads(1)

GOAL = np.array([0.5, -0.5, 0.0], np.float32)
RULE = InterventionRule(beta=0.0, switch_every=4, gate=NoGateConfig(), steps=(30, 30))


def shared(
    rule: InterventionRule, policy: Any = None, seeds: Sequence[int] = (0, 1, 2), steps: int = 30
) -> list[Episode]:
    """What becomes of a policy (by default one that moves at random) and the expert at one hand."""
    envs = [PointEnv(PointConfig()) for _ in seeds]
    for env, seed in zip(envs, seeds, strict=True):
        env.reset(seed)
    actor = DaggerActor(policy or RandomActor(3), PointExpert(), rule)
    outcomes = rollout(envs, actor, [Goal(GOAL)] * len(seeds), seeds=seeds, max_steps=steps)
    return [outcome.episode for outcome in outcomes if outcome.episode is not None]


def expert_at(sim_state: Array) -> Decision:
    env, expert = PointEnv(PointConfig()), PointExpert()
    env.set_state(sim_state)
    expert.reset([Goal(GOAL)], [0])
    return expert.act([env.observe()], [True])[0]


def test_the_label_is_the_experts_answer_wherever_one_is() -> None:
    """Asked again in every recorded state, it gives the recorded label; a random policy rarely does."""
    for episode in shared(replace(RULE, beta=0.3)):
        for t, label in enumerate(episode.expert_action):
            np.testing.assert_array_equal(label, expert_at(episode.sim_state[t]).action)
        own = ~episode.intervention
        assert 0 < own.sum() < len(episode)
        np.testing.assert_array_equal(episode.action[~own], episode.expert_action[~own])
        assert (episode.action[own] != episode.expert_action[own]).any(axis=1).all()
        assert set(episode.meta.skills) <= {"fetch", "carry", "press", "rest"}


@pytest.mark.parametrize(("beta", "intervened"), [(0.0, False), (1.0, True)])
def test_at_0_only_the_policy_acts_and_at_1_only_the_expert(beta: float, intervened: bool) -> None:
    """The actions are bit for bit those of either, let loose by itself."""
    for seed, episode in enumerate(shared(replace(RULE, beta=beta))):
        assert (episode.intervention == intervened).all()
        env = PointEnv(PointConfig())
        env.reset(seed)
        actor: Any = PointExpert() if intervened else RandomActor(3)
        single = rollout([env], actor, [Goal(GOAL)], seeds=[seed], max_steps=30)[0].episode
        assert single is not None
        np.testing.assert_array_equal(episode.action, single.action)


def test_beta_is_the_fraction_of_stretches_and_each_row_draws_its_own() -> None:
    """3 of 10 stretches of 4 steps: of 40 rollouts with 10 each, 120 +- 4 std of 9.2 are the expert's."""
    episodes = shared(replace(RULE, beta=0.3, steps=(40, 40)), seeds=range(40), steps=40)
    whole = [episode for episode in episodes if len(episode) == 40]  # random actions may push the puck off
    stretches = np.stack([episode.intervention.reshape(10, 4) for episode in whole])
    assert (stretches == stretches[:, :, :1]).all(), "who acts changes between stretches only"
    expected, std = 0.3 * 10 * len(whole), np.sqrt(0.3 * 0.7 * 10 * len(whole))
    assert abs(stretches[:, :, 0].sum() - expected) < 4 * std
    assert len({tuple(row) for row in stretches[:, :, 0].tolist()}) > len(whole) / 2
    single = shared(replace(RULE, beta=0.3, steps=(40, 40)), seeds=[7], steps=40)[0]
    np.testing.assert_array_equal(single.intervention, episodes[7].intervention)


def test_the_expert_finishes_after_a_drawn_number_of_steps() -> None:
    lengths = [
        int(np.argmax(episode.intervention)) for episode in shared(replace(RULE, steps=(5, 20)), seeds=range(20))
    ]
    assert min(lengths) >= 5
    assert max(lengths) <= 20
    assert len(set(lengths)) > 5
    for episode, length in zip(shared(replace(RULE, steps=(5, 20)), seeds=range(20)), lengths, strict=True):
        assert episode.intervention[length:].all(), "for good"


def test_the_policy_gets_the_hand_back_where_it_plans_anew() -> None:
    """Stretches of 3 steps, plans of 4: an expert's stretch that ends at step 3 lasts until step 4."""
    for episode in shared(replace(RULE, beta=0.5, switch_every=3, plans=4), seeds=range(10)):
        back = np.flatnonzero(np.diff(episode.intervention.astype(int)) == -1) + 1
        assert (back % 4 == 0).all()


def test_schedules() -> None:
    """Constant; start, then a fifth of it less each round to 0; p^(i-1)."""
    assert [ConstantConfig(0.3).at(i) for i in (1, 2, 9)] == [0.3] * 3
    assert [LinearConfig(start=0.5, rounds=5).at(i) for i in range(1, 8)] == pytest.approx(
        [0.5, 0.4, 0.3, 0.2, 0.1, 0, 0]
    )
    assert [ExponentialConfig(base=0.5).at(i) for i in (1, 2, 3, 4)] == [1.0, 0.5, 0.25, 0.125]
    assert ZeroConfig().at(1) == 0
    assert sorted(BetaConfig.get_known_choices()) == ["constant", "exponential", "linear", "zero"]
    for wrong in ({"type": "constant", "value": 1.5}, {"type": "linear", "rounds": 0}, {"type": "cosine"}):
        with pytest.raises(UsageError):
            from_dict(DaggerConfig, {"beta": wrong})


def opened(gate: Gate, distances: Sequence[float]) -> list[int]:
    return [int(gate(GateSignal(distance, std=distance))) for distance in distances]


@pytest.mark.parametrize("kind", [DistanceConfig, UncertaintyConfig])
def test_a_gate_opens_after_steps_running_and_closes_on_agreement(kind: Any) -> None:
    """Above 0.5 for 2 steps running opens; at most 0.2 for 3 steps running closes; between, it stays."""
    gate = kind(open_above=0.5, steps=2, close_below=0.2, close_after=3).build()
    assert opened(gate, [0.6, 0.1, 0.6, 0.6, 0.3, 0.1, 0.1, 0.3, 0.1, 0.1, 0.2, 0.6, 0.6]) == [
        *(0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 1)
    ]
    assert opened(kind(open_above=0.5, steps=1, max_steps=3).build(), [1.0] * 9) == [1, 1, 1, 0, 1, 1, 1, 0, 1]
    assert opened(NoGateConfig().build(), [9.0] * 3) == [0, 0, 0]


def test_a_gate_hands_over_to_the_expert_and_back() -> None:
    """A policy that stands still agrees with the expert only once everything is done."""

    class Still(RandomActor):
        def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
            return [Decision(np.zeros(3, np.float32)) for _ in active]

    gate = DistanceConfig(open_above=0.3, steps=3, close_after=4)
    for episode in shared(replace(RULE, gate=gate, steps=(80, 80)), Still(3), steps=80):
        apart = np.abs(episode.expert_action).max(axis=1) > 0.3
        assert apart[:3].all()
        assert episode.intervention[:3].tolist() == [False, False, True]
        done = len(apart) - int(np.argmax(apart[::-1]))  # from here on nothing is left to do
        assert not episode.intervention[done + 4 :].any()
        assert len(episode) > done + 4


@pytest.mark.slow
def test_what_is_never_unsure_has_no_spread() -> None:
    """Sampled again, a regressed chunk is the same and a denoised one another, in every row by itself."""
    policies = [
        PolicyConfig(chunk=8).build(spec(), None, 0),
        PolicyConfig(head=DiffusionConfig(), chunk=8).build(spec(), None, 0),
    ]
    stds = []
    for policy in policies:
        actor = PolicyActor(policy, n_action_steps=4)
        env = PointEnv(PointConfig())
        env.reset(0)
        goals = [Goal(GOAL)] * 2
        for rows in (2, 1):
            actor.reset(goals[:rows], range(rows))
            actor.act([env.observe()] * rows, [True] * rows)
            stds.append(actor.std(4, [torch.Generator().manual_seed(k) for k in range(rows)]))
    sure, _, unsure, single = stds
    assert sure.tolist() == [0, 0]
    assert (unsure > 0).all()
    assert unsure[0] != unsure[1]
    assert single[0] == pytest.approx(unsure[0], rel=1e-5)


def test_every_gate_is_built() -> None:
    for name in GateConfig.get_known_choices():
        assert GateConfig.get_choice_class(name)().build()(GateSignal(0.0)) is False
