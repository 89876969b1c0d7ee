"""Laws of heatmaps that are taught where things are in an image, and of an image encoder that is trained alone."""

from dataclasses import replace

import pytest
import torch

from playlearn.errors import UsageError
from playlearn.policies import PolicySpec
from playlearn.policies.encoders import KeypointsConfig
from playlearn.policies.encoders.keypoints import Glimpses, cell_centers, heatmap_loss
from tests.policies.parts import S, examples, generator, policy

SEEING = {"fusion": "late", "state_supervision": 1.0, "use_estimated_state": True, "feed_cameras": []}
PLACED = PolicySpec(
    state_names=tuple(f"state.{i}" for i in range(S)),
    achieved_names=("red.x", "red.y", "red.z", "lamp"),
    action_names=("dx", "dy", "gripper"),
    fps=20.0,
    cameras={"front": (16, 16), "wrist": (16, 16)},
)


def test_the_best_heatmap_points_exactly_at_its_point() -> None:
    """The loss is least where the map is its target, whose mean over the cells' centers is the point itself."""
    points = torch.rand(6, 2, 2, generator=generator()) * 1.6 - 0.8
    logits = torch.zeros(6, 3, 8, 12, requires_grad=True)
    optimizer = torch.optim.Adam([logits], lr=0.5)
    for _ in range(300):
        optimizer.zero_grad()
        heatmap_loss(logits, points).backward()
        optimizer.step()
    weights = logits.detach()[:, :2].flatten(2).softmax(-1).view(6, 2, 8, 12)
    x = (weights.sum(2) * cell_centers(12)).sum(-1)
    y = (weights.sum(3) * cell_centers(8)).sum(-1)
    torch.testing.assert_close(torch.stack([x, y], -1), points, atol=0.02, rtol=0)
    assert not logits.detach()[:, 2].any(), "a map of no object is taught nothing"


def test_what_is_out_of_the_image_counts_for_nothing() -> None:
    logits = torch.randn(3, 2, 4, 4, generator=generator())
    points = torch.tensor([[[0.1, 0.2], [1.2, 0.0]], [[torch.nan, torch.nan], [0.0, -3.0]], [[-0.5, 0.5], [0.3, 0.3]]])
    seen = torch.stack(
        [heatmap_loss(logits[i : i + 1, k : k + 1], points[i : i + 1, k : k + 1]) for i, k in ((0, 0), (2, 0), (2, 1))]
    )
    torch.testing.assert_close(heatmap_loss(logits, points), seen.mean())
    assert heatmap_loss(logits, torch.full((3, 2, 2), torch.nan)) == 0


def test_heatmaps_learn_from_keypoints_alone() -> None:
    """Without keypoints the maps' loss is not there; with them its gradient reaches both cameras' convolutions."""
    ours = policy("keypoints", encoder_options=SEEING)
    batch = examples()
    assert "keypoints" not in ours(batch, generator())[1]
    pixels = torch.rand(5, 1, 1, 2, generator=generator()) - 0.5
    shown = {"keypoints": {"front": pixels, "wrist": pixels}, "goal_keypoints": {"front": pixels[:, 0]}}
    loss, parts = ours(replace(batch, **shown), generator())
    assert parts["keypoints"] > 0
    torch.testing.assert_close(loss.detach(), sum(parts[name] for name in ("head", "achieved", "keypoints")))


def test_a_glimpse_is_the_square_of_pixels_around_its_place() -> None:
    """At a border it is the last one that lies within the image."""
    glimpses = Glimpses(6, 3, 64, 3, (12, 20))
    images = torch.rand(2, 3, 12, 20, generator=generator())
    places = torch.tensor([[[0.0, 0.0], [-1.0, 1.0], [0.93, -0.2]], [[-0.5, 0.5], [1.0, -1.0], [0.1, 0.0]]])
    corners = glimpses.corners(places)
    # columns and rows: a place of 0 is the edge between the middle two of an even number of pixels
    assert corners.tolist() == [[[7, 3], [0, 6], [14, 2]], [[2, 6], [14, 0], [8, 3]]]
    squares = glimpses.cut(images.contiguous(memory_format=torch.channels_last), corners)
    for image, own, looks in zip(images, corners.tolist(), squares, strict=True):
        for (column, row), square in zip(own, looks, strict=True):
            assert torch.equal(square, image[:, row : row + 6, column : column + 6])


def test_a_glimpse_tells_where_it_was_taken_and_only_of_its_own_square() -> None:
    glimpses = Glimpses(6, 2, 4, 3, (12, 20))
    image, places = torch.rand(1, 3, 12, 20, generator=generator()), torch.tensor([[[-0.6, 0.0], [0.6, 0.0]]])
    told = glimpses(image, places)
    assert told.shape == (1, 2, 4 + 2)
    torch.testing.assert_close(told[0, :, 4:] / 4, places[0], atol=0.05, rtol=0)
    changed = image.clone()
    changed[..., 12:] = 0.0  # nothing of the first square
    other = glimpses(changed, places)
    torch.testing.assert_close(other[0, 0], told[0, 0])
    assert not torch.equal(other[0, 1], told[0, 1])


def test_glimpses_are_learned_with_the_estimate() -> None:
    ours = policy("keypoints", encoder_options={**SEEING, "glimpse": 8})
    ours.freeze_except(("encoder.front.*",))
    ours(examples(), generator())[0].backward()
    for name, parameter in ours.encoder.front.glimpses.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_an_encoder_alone_gets_the_gradient_it_would_get_in_the_whole_policy() -> None:
    """Its loss has no part of the head's, and what the head's loss would have taught is not asked for."""
    batch = examples(count=4)
    patterns = ("encoder.front.*", "encoder.others.*", "encoder.estimate.*")
    for kind in ("cnn", "keypoints"):
        whole, alone = (policy(kind, encoder_options=SEEING, goal_dropout=0.0) for _ in range(2))
        alone.freeze_except(patterns)
        assert whole.acting_learns
        assert not alone.acting_learns
        whole(batch, generator())[0].backward()
        loss, parts = alone(batch, generator())
        loss.backward()
        assert "head" not in parts
        for (name, one), other in zip(alone.named_parameters(), whole.parameters(), strict=True):
            if one.requires_grad:
                torch.testing.assert_close(one.grad, other.grad, msg=name)
        assert "head" in policy(kind, encoder_options=SEEING).loss(batch, generator())[1]


def test_a_head_that_learns_from_features_is_trained_with_them() -> None:
    """Where the policy sees a camera's features its loss teaches the images, so nothing of it may be left out."""
    ours = policy("cnn", encoder_options={**SEEING, "feed_cameras": ["wrist"]})
    ours.freeze_except(("encoder.front.*", "encoder.others.*"))
    assert ours.acting_learns


def test_an_observation_that_is_its_own_goal_is_seen_once_and_tells_the_same() -> None:
    ours = policy("keypoints", encoder_options=SEEING).eval()
    batch = examples(count=3)
    same = replace(batch, goal_images={"front": batch.images["front"][:, 0]})
    apart = replace(batch, goal_images={"front": batch.images["front"][:, 0].clone()})
    looks = []
    ours.encoder.front.register_forward_pre_hook(lambda _, inputs: looks.append(len(inputs[0])))
    one, other = (ours.encoder.perceive(ours.normalized(b)) for b in (same, apart))
    assert looks == [3, 6]
    torch.testing.assert_close(one.observed, other.observed)
    torch.testing.assert_close(one.wanted, other.wanted)
    torch.testing.assert_close(one.goal_heatmaps["front"], other.goal_heatmaps["front"])


def test_what_contradicts_itself_is_refused() -> None:
    with pytest.raises(UsageError, match=r"heatmaps is 0: give one each of the 1 objects, or more"):
        KeypointsConfig(heatmaps=0).build(PLACED, 8)
    with pytest.raises(UsageError, match=r"encoder\.shift moves images and not their keypoints"):
        KeypointsConfig(shift=1).build(PLACED, 8)
    for side in (4, 17):
        with pytest.raises(UsageError, match=rf"encoder\.glimpse is {side} pixels: give 5 to 16"):
            KeypointsConfig(glimpse=side).build(PLACED, 8)
