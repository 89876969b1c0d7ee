"""Laws of what a goal is shown as: an image, a state or either, and whether it speaks of the arm."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from playlearn.episode import Goal
from playlearn.errors import UsageError
from playlearn.policies import EncoderConfig, PolicyActor
from playlearn.policies.encoders.cameras import CamerasConfig
from tests.policies.parts import ENCODERS, SPEC, Examples, G, S, examples, generator, policy

ESTIMATE = {"state_supervision": 1.0, "use_estimated_state": True}
LOOKING = [kind for kind in ENCODERS if issubclass(EncoderConfig.get_choice_class(kind), CamerasConfig)]
FUSED = [("cnn", {"fusion": "early"}), ("cnn", {"fusion": "late"}), ("cnn", ESTIMATE)]
FUSED = [*FUSED, ("cnn", {"fusion": "late", **ESTIMATE}), *((kind, {}) for kind in LOOKING if kind != "cnn")]
looking = pytest.mark.parametrize(("encoder", "options"), FUSED)
either = pytest.mark.parametrize(("encoder", "options"), [one for one in FUSED if one[0] != "hand"])  # images only


def told(batch: Examples) -> Examples:
    """The same goals as states alone."""
    return dataclasses.replace(batch, goal_images={})


def other_state(batch: Examples) -> Examples:
    return dataclasses.replace(batch, goal_achieved=examples(seed=3).goal_achieved)


def other_image(batch: Examples) -> Examples:
    return dataclasses.replace(batch, goal_images=examples(seed=3).goal_images)


@either
def test_a_goal_that_is_a_state_needs_no_image(encoder: str, options: dict[str, Any]) -> None:
    made = policy(encoder, encoder_options={**options, "goal": "state"}).eval()
    assert made.config.encoder.goal_cameras == ()
    batch = told(examples())
    plain = made.act(batch, generator())
    assert not torch.equal(made.act(other_state(batch), generator()), plain)
    forgot = made.act(batch, generator(), guidance=0.0)
    assert torch.equal(made.act(other_state(batch), generator(), guidance=0.0), forgot)
    made.train()
    loss, _ = made(batch, generator())
    loss.backward()
    reached = {name for name, p in made.named_parameters() if p.grad is not None}
    assert reached == {name for name, _ in made.named_parameters()}


@either
def test_shown_either_way_it_reads_what_it_is_given(encoder: str, options: dict[str, Any]) -> None:
    """An image hides the state, which only counts where there is no image; nothing of a withheld goal is seen."""
    made = policy(encoder, encoder_options={**options, "goal": "both"}).eval()
    batch = examples()
    seen, heard = made.act(batch, generator()), made.act(told(batch), generator())
    assert torch.equal(made.act(other_state(batch), generator()), seen)
    assert not torch.equal(made.act(other_image(batch), generator()), seen)
    assert not torch.equal(made.act(told(other_state(batch)), generator()), heard)
    forgot = made.act(batch, generator(), guidance=0.0)
    for other in (other_state(batch), other_image(batch), told(batch)):
        assert torch.equal(made.act(other, generator(), guidance=0.0), forgot)


@pytest.mark.slow
@either
def test_training_gives_a_fraction_of_goal_images(encoder: str, options: dict[str, Any]) -> None:
    """At a share of 1 a goal's state changes nothing but what images must tell on the side; at 0 its image does not."""
    batch = examples(8)
    elsewhere = examples(8, seed=3)
    others = {
        0.0: dataclasses.replace(batch, goal_images=elsewhere.goal_images),
        1.0: dataclasses.replace(batch, goal_achieved=elsewhere.goal_achieved),
    }
    for share, other in others.items():
        made = policy(encoder, encoder_options={**options, "goal": "both", "image_goal_prob": share}, goal_dropout=0.0)
        first, second = (made(one, generator())[1]["head"] for one in (batch, other))
        assert torch.equal(first, second)
        opposite = policy(encoder, encoder_options={**options, "goal": "both", "image_goal_prob": 1 - share})
        assert not torch.equal(opposite(batch, generator())[1]["head"], opposite(other, generator())[1]["head"])


def test_the_fraction_of_goal_images_is_the_configured_one() -> None:
    """Of 4,000 examples 1,000 +- 27 (one standard deviation) are shown an image at a share of a quarter."""
    config = policy("cnn", encoder_options={"goal": "both", "image_goal_prob": 0.25}).config.encoder
    assert isinstance(config, CamerasConfig)
    many = examples(4000)
    assert config.has_goal_image(many, generator()).sum().item() == pytest.approx(1000, abs=4 * 27)
    assert config.has_goal_image(many, None).all(), "without a draw, what there is to be seen is seen"


def test_a_goal_of_the_arm_is_read_where_it_was_asked_for() -> None:
    batch = examples()
    elsewhere = dataclasses.replace(batch, goal_proprio=examples(seed=3).goal_proprio)
    for arm in (False, True):
        made = policy(encoder_options={"goal_proprio": arm}).eval()
        assert torch.equal(made.act(batch, generator()), made.act(elsewhere, generator())) != arm
        forgot = made.act(batch, generator(), guidance=0.0)
        assert torch.equal(made.act(elsewhere, generator(), guidance=0.0), forgot)


def test_a_goal_is_the_robots_own_pose_alone_where_there_are_no_objects_or_none_is_wanted() -> None:
    """Nothing is read of `goal_achieved`; forgotten is only the pose."""
    batch = examples()
    bare = dataclasses.replace(batch, achieved=batch.achieved[..., :0], goal_achieved=batch.goal_achieved[:, :0])
    config, other = policy(encoder_options={"goal_proprio": True}).config, examples(seed=3)
    unwanted = policy(encoder_options={"goal_proprio": True, "goal_names": []}).eval()
    robot_only = config.build(dataclasses.replace(SPEC, achieved_names=()), None, seed=0).eval()
    for made, own in ((unwanted, batch), (robot_only, bare)):
        plain = made.act(own, generator())
        assert not torch.equal(made.act(dataclasses.replace(own, goal_proprio=other.goal_proprio), generator()), plain)
        forgot = made.act(own, generator(), guidance=0.0)
        assert not torch.equal(forgot, plain)
    assert torch.equal(unwanted.act(other_state(batch), generator()), unwanted.act(batch, generator()))


def test_images_are_supervised_with_what_is_recorded() -> None:
    made = policy("cnn", encoder_options={"state_supervision": 1.0}).config
    with pytest.raises(UsageError, match=r"state_supervision: this play records no objects .* leave it at 0"):
        made.build(dataclasses.replace(SPEC, achieved_names=()), None, seed=0)


def test_an_actor_gives_a_policy_the_configured_kind_of_goal() -> None:
    frames = {camera: np.zeros((*size, 3), np.uint8) for camera, size in SPEC.cameras.items()}
    whole = Goal(np.zeros(G, np.float32), frames, np.zeros(S, np.float32))
    blind = dataclasses.replace(whole, images={})
    both = policy("cnn", encoder_options={"goal": "both"})
    PolicyActor(both, n_action_steps=2, goal="state").reset([blind], [0])
    with pytest.raises(UsageError, match="'front' image, and there is none"):
        PolicyActor(both, n_action_steps=2, goal="image").reset([blind], [0])
    with pytest.raises(UsageError, match="from state, not from image"):
        PolicyActor(policy(), n_action_steps=2, goal="image")
    stateless = dataclasses.replace(whole, state=None)
    PolicyActor(policy(), n_action_steps=2).reset([stateless], [0])
    with pytest.raises(UsageError, match="goals with the robot's state \\(goal_proprio\\)"):
        PolicyActor(policy(encoder_options={"goal_proprio": True}), n_action_steps=2).reset([stateless], [0])
