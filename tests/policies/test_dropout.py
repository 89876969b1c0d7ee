"""Laws of what is withheld in training: the goal, the past, the robot's own state."""

import dataclasses
from typing import Any

import pytest
import torch

from playlearn.config import from_dict
from playlearn.errors import UsageError
from playlearn.policies import Policy, PolicyConfig
from tests.policies.parts import ENCODERS, SPEC, Examples, examples, generator, small, spreads


def made(encoder: str = "state", **options: Any) -> Policy:
    """No goal is withheld, and the head is one whose loss draws nothing."""
    parts = {"encoder": small(encoder), "trunk": small("mlp"), "head": small("deterministic"), "chunk": 4}
    return from_dict(PolicyConfig, {**parts, "history": 3, "goal_dropout": 0.0, **options}).build(SPEC, spreads(), 0)


def loss(policy: Policy, batch: Examples) -> torch.Tensor:
    return policy(batch, generator(1))[0]


def replaced_state(batch: Examples) -> Examples:
    return dataclasses.replace(batch, state=examples(len(batch.state), history=3, seed=9).state)


@pytest.mark.slow
@pytest.mark.parametrize("encoder", ENCODERS)
def test_a_hidden_past_and_a_withheld_body_leave_no_trace(encoder: str) -> None:
    """With a share of 1 the training loss is the same whatever the past, or the body, was; with 0 it is not."""
    batch = examples(6, history=3)
    other = examples(6, history=3, seed=9)
    past = torch.tensor([True, True, False])[None, :, None]
    elsewhere = dataclasses.replace(
        batch,
        state=torch.where(past, other.state, batch.state),
        achieved=torch.where(past, other.achieved, batch.achieved),
    )
    plain, blind, numb = made(encoder), made(encoder, history_dropout=1.0), made(encoder, proprio_dropout=1.0)
    assert not torch.equal(loss(plain, batch), loss(plain, elsewhere))
    assert torch.equal(loss(blind, batch), loss(blind, elsewhere))
    assert torch.equal(loss(numb, batch), loss(numb, replaced_state(batch)))
    assert not torch.equal(loss(plain, batch), loss(plain, replaced_state(batch)))


@pytest.mark.parametrize("option", ["history_dropout", "proprio_dropout"])
def test_only_training_withholds(option: str) -> None:
    """The held-out loss and the actions are those of a policy without the option, to the bit."""
    batch = examples(6, history=3)
    with_it, without = made(**{option: 1.0}).eval(), made().eval()
    assert torch.equal(with_it.loss(batch, generator())[0], without.loss(batch, generator())[0])
    assert torch.equal(with_it.act(batch, generator()), without.act(batch, generator()))
    assert not torch.equal(loss(with_it, batch), loss(without, batch))


def test_the_fraction_is_the_configured_one() -> None:
    """Of 4,000 examples 1,200 +- 29 (one standard deviation) lose their past at a share of 0.3."""
    policy, seen = made(history_dropout=0.3), []
    policy.trunk.register_forward_hook(lambda _, given, __: seen.append(given[1]))
    loss(policy, examples(4000, history=3))
    present = seen[0].unflatten(1, (-1,))[:, 1:].unflatten(1, (3, -1))  # (B, T, M), the goal's token left out
    assert present[:, -1].all()
    assert (~present[:, 0, 0]).sum().item() == pytest.approx(1200, abs=4 * 29)
    assert torch.equal(present[:, 0], present[:, 1])


def test_what_is_not_withheld_changes_no_draw() -> None:
    """The generator stands where it stood after goal dropout alone: runs from before the options are repeated."""
    after = generator(1)
    torch.rand(6, generator=after)
    used = generator(1)
    made()(examples(6, history=3), used)
    assert torch.equal(used.get_state(), after.get_state())


def test_a_fraction_above_one_is_refused() -> None:
    with pytest.raises(UsageError, match=r"history_dropout is a fraction.*got 1\.5"):
        PolicyConfig(history_dropout=1.5)
