"""What every registered encoder, trunk and head must do; a new kind is tested the day it is added."""

import dataclasses
from pathlib import Path

import pytest
import torch

from playlearn.config import from_dict
from playlearn.errors import CheckpointError
from playlearn.policies import HeadConfig, Policy, PolicyConfig
from tests.policies.parts import (
    ENCODERS,
    HEADS,
    MULTIMODAL,
    SPEC,
    TRUNKS,
    A,
    H,
    examples,
    generator,
    policy,
    small,
    take,
    train_on_two_modes,
)

IMAGE_ENCODERS = [kind for kind in ENCODERS if kind != "state"]
# every head, every encoder with a head that draws noise and one that does not, every trunk: a head sees only features
KINDS = [
    *(("state", "mlp", head) for head in HEADS),
    *((encoder, "mlp", "deterministic") for encoder in IMAGE_ENCODERS),
    *(pytest.param(encoder, "mlp", "diffusion", marks=pytest.mark.slow) for encoder in IMAGE_ENCODERS),
    *(("state", trunk, "deterministic") for trunk in TRUNKS if trunk != "mlp"),
]
# What 500 updates on one number a step take; a kind that is not named here is trained as `small` builds it.
TWO_MODES = {"cvae": {"kl": 0.1, "warmup": 100}, "latent_plan": {"kl": 0.1}}


def held_closer(head: str) -> bool:
    """Whether test_heads.py holds such a head to two modes, and to more."""
    return any(isinstance(config, HeadConfig.get_choice_class(head)) for config in MULTIMODAL.values())


every_kind = pytest.mark.parametrize(("encoder", "trunk", "head"), KINDS)


@every_kind
def test_a_saved_policy_acts_as_it_did(encoder: str, trunk: str, head: str, tmp_path: Path) -> None:
    model = policy(encoder, trunk, head, history=2).eval()
    batch = examples(3, history=2)
    before = model.act(batch, generator(7))
    model.save(tmp_path / "policy")
    loaded = Policy.load(tmp_path / "policy")
    after = loaded.act(batch, generator(7))
    assert loaded.config == model.config
    assert loaded.spec == model.spec
    assert before.shape == (3, H, A)
    assert before.dtype == torch.float32
    assert before.abs().max() <= 1
    assert torch.equal(before, after)


@every_kind
def test_a_row_does_not_depend_on_its_neighbors(encoder: str, trunk: str, head: str) -> None:
    model = policy(encoder, trunk, head).eval()
    batch = examples(4)
    together = model.act(batch, [generator(seed) for seed in range(4)], guidance=1.5)
    single = model.act(take(batch, slice(2, 3)), [generator(2)], guidance=1.5)
    # only the order of float32 sums may differ with the size of a matrix
    torch.testing.assert_close(together[2:3], single, atol=2e-5, rtol=0)


@every_kind
def test_a_chunk_is_a_function_of_inputs_and_generator(encoder: str, trunk: str, head: str) -> None:
    model = policy(encoder, trunk, head).eval()
    batch = examples()
    assert torch.equal(model.act(batch, generator(3)), model.act(batch, generator(3)))
    modes = model.act(batch, generator(3), mode=True), model.act(batch, generator(4), mode=True)
    assert torch.equal(*modes)


@every_kind
def test_masked_actions_teach_nothing(encoder: str, trunk: str, head: str) -> None:
    """The loss and every gradient stay the same, to the bit, when masked actions become nonsense."""
    model = policy(encoder, trunk, head)
    batch = examples()
    mask = batch.action_mask.clone()
    mask[:, 2:] = False
    mask[0] = False  # an example may have no action at all
    nonsense = batch.action.clone()
    nonsense[~mask] = 1e6
    outcomes = []
    for action in (batch.action, nonsense):
        model.zero_grad()
        loss, _ = model(dataclasses.replace(batch, action=action, action_mask=mask), generator(5))
        loss.backward()
        outcomes.append([loss.detach(), *(p.grad for p in model.parameters() if p.grad is not None)])
    assert outcomes[0][0] > 0
    assert all(torch.equal(one, other) for one, other in zip(*outcomes, strict=True))


@pytest.mark.parametrize("head", HEADS)
def test_a_masked_action_gets_no_gradient(head: str) -> None:
    model = policy(head=head)
    features = torch.randn(3, 32, generator=generator())
    chunk = torch.randn(3, H, A, generator=generator(1)).requires_grad_()
    mask = torch.tensor([[True, True, False, False], [True] * 4, [False] * 4])
    loss, _ = model.head.loss(features, chunk, mask, generator(2))
    loss.backward()
    if chunk.grad is None:  # a head that makes tokens of numbers passes no gradient to them at all
        return
    assert (chunk.grad[~mask] == 0).all()
    assert (chunk.grad[mask] != 0).any(dim=-1).all()


@pytest.mark.slow
@pytest.mark.parametrize("head", [head for head in HEADS if not held_closer(head)])
def test_two_equally_good_chunks_are_both_sampled_and_not_their_mean_unless_the_head_is_unimodal(head: str) -> None:
    """Of the data half is +1 at all four steps, half -1; a sample is near a mode if no step is off by 0.5.

    A head that regresses is near one mode at most. A Gaussian of mean 0 and std 1 has 24 % of each step near +1, so
    2 * 0.24^4 < 1 % of its chunks are near a mode. Over seeds the heads of several modes had 70 % or more there, and
    25 % or more at each. Continuous latents (cvae, latent_plan) have the least: some must lead to what lies between.
    """
    config = from_dict(PolicyConfig, {"head": small(head, **TWO_MODES.get(head, {}))}).head
    trained = train_on_two_modes(config, updates=500, steps=4, positive=0.5, decay=True)
    with torch.no_grad():
        samples = trained.sample(torch.ones(400, 2), generator(2)).squeeze(-1)  # (400, 4)
    near = [((samples - mode).abs() < 0.5).all(1).float().mean().item() for mode in (1.0, -1.0)]
    assert (sum(near) > 0.5 and min(near) > 0.15) == (not config.unimodal), near


@every_kind
def test_guidance_of_one_is_the_plain_prediction_and_of_zero_forgets_the_goal(
    encoder: str, trunk: str, head: str
) -> None:
    model = policy(encoder, trunk, head).eval()
    batch, other = examples(), examples(seed=9)
    elsewhere = dataclasses.replace(batch, goal_achieved=other.goal_achieved, goal_images=other.goal_images)
    plain = model.act(batch, generator(1))
    assert torch.equal(model.act(batch, generator(1), guidance=1.0), plain)
    assert not torch.equal(model.act(elsewhere, generator(1)), plain), (
        "the goal must matter, or this test shows nothing"
    )
    assert torch.equal(model.act(batch, generator(1), guidance=0.0), model.act(elsewhere, generator(1), guidance=0.0))
    # continuity: next to 1, two predictions combined come next to the single one
    torch.testing.assert_close(model.act(batch, generator(1), guidance=1 + 1e-6), plain, atol=1e-4, rtol=0)


@every_kind
def test_padded_history_does_not_reach_the_features(encoder: str, trunk: str, head: str) -> None:
    """Observations that the mask hides may be anything."""
    model = policy(encoder, trunk, head, history=3).eval()
    batch = examples(2, history=3)
    mask = torch.tensor([[False, True, True], [False, False, True]])
    hidden, noise = dataclasses.replace(batch, history_mask=mask), examples(2, history=3, seed=4)
    other = dataclasses.replace(
        hidden,
        state=torch.where(mask[..., None], batch.state, noise.state),
        achieved=torch.where(mask[..., None], batch.achieved, noise.achieved),
    )
    torch.testing.assert_close(model.act(hidden, generator()), model.act(other, generator()), atol=1e-6, rtol=0)
    full = model.act(batch, generator())
    assert not torch.allclose(full, model.act(hidden, generator()), atol=1e-4), "an unmasked history must matter"


@every_kind
def test_every_weight_gets_a_gradient(encoder: str, trunk: str, head: str) -> None:
    """With some goals withheld and some shown, no parameter is without a gradient."""
    model = policy(encoder, trunk, head, goal_dropout=0.5)
    loss, _ = model(examples(8), generator(3))
    loss.backward()
    assert [name for name, p in model.named_parameters() if p.grad is None] == []


def test_fresh_weights_follow_the_seed_and_leave_global_randomness_alone() -> None:
    before = torch.random.get_rng_state()
    one, same, other = policy(seed=1), policy(seed=1), policy(seed=2)
    assert torch.equal(before, torch.random.get_rng_state())
    weights = [torch.cat([p.flatten() for p in model.parameters()]) for model in (one, same, other)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


@pytest.mark.parametrize("name", ["policy.json", "policy.safetensors"])
def test_a_torn_policy_is_one_message(name: str, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no policy at"):
        Policy.load(tmp_path)
    policy().save(tmp_path)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CheckpointError, match="cannot be read"):
        Policy.load(tmp_path)


def test_a_policy_refuses_another_environment() -> None:
    model = policy("cnn")
    cameras = dict(SPEC.cameras)
    model.check(SPEC, {**cameras, "extra": (8, 8)})
    with pytest.raises(CheckpointError, match=r"another action.*expects gripper.*has finger"):
        model.check(dataclasses.replace(SPEC, action_names=("dx", "dy", "finger")), cameras)
    with pytest.raises(CheckpointError, match=r"another achieved.*order"):
        model.check(dataclasses.replace(SPEC, achieved_names=SPEC.achieved_names[::-1]), cameras)
    with pytest.raises(CheckpointError, match=r"20 Hz.*10 Hz"):
        model.check(dataclasses.replace(SPEC, fps=10.0), cameras)
    with pytest.raises(CheckpointError, match=r"camera 'wrist'.*not there"):
        model.check(SPEC, {"front": (16, 16)})
    with pytest.raises(CheckpointError, match=r"\(32, 32\).*\(16, 16\)"):
        model.check(SPEC, {**cameras, "front": (32, 32)})
    policy("state").check(SPEC, {})  # reads no camera, so none is asked for
