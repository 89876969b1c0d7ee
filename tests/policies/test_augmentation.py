"""Random shifts move an observation and its goal image together: shifted apart, a goal would lie elsewhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from tests.policies.parts import Examples, examples, generator, policy

SHIFT = 3
KINDS = {
    "cnn, early fusion": ("cnn", {"fusion": "early"}),
    "cnn, late fusion": ("cnn", {"fusion": "late"}),
    "keypoints": ("keypoints", {"fusion": "late", "keypoints": 0.0, "glimpse": 0}),
    "tokens": ("tokens", {}),
}


def own_goals(count: int) -> Examples:
    """Examples whose goal image is the observation, in memory of its own: any difference is the augmentation's."""
    shown = examples(count)
    return replace(shown, goal_images={"front": shown.images["front"][:, -1].clone()})


@contextmanager
def looked_at(network: nn.Module) -> Iterator[list[Tensor]]:
    """The images that reach the first convolutions of a network, as (B, 3 or 6, h, w)."""
    seen: list[Tensor] = []
    first = {id(m): m for m in network.modules() if isinstance(m, nn.Conv2d) and m.in_channels in (3, 6)}
    hooks = [m.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].detach())) for m in first.values()]
    try:
        yield seen
    finally:
        for hook in hooks:
            hook.remove()


@pytest.mark.parametrize("kind", KINDS)
def test_a_goal_image_is_shifted_with_the_observation(kind: str) -> None:
    encoder, options = KINDS[kind]
    made = policy(
        encoder,
        encoder_options={"cameras": ["front"], "goal_camera": "front", "shift": SHIFT, **options},
        goal_dropout=0.0,
    ).train()
    batch = own_goals(16)
    with looked_at(made.encoder) as seen:
        made(batch, generator(0))  # as in training
    frames = torch.cat([image.reshape(-1, 3, *image.shape[2:]) for image in seen])  # observations and goals
    plain = torch.cat([batch.images["front"].flatten(0, 1), batch.goal_images["front"]])
    assert len(frames) == len(plain) == 32
    # Every distinct picture is seen twice, once as the observation and once as its goal, under the same shift.
    keys = sorted(frame.flatten().tolist() for frame in frames)
    assert all(keys[i] == keys[i + 1] for i in range(0, 32, 2))
    originals = {tuple(row) for row in (plain.float() * (2 / 255) - 1).permute(0, 3, 1, 2).flatten(1).tolist()}
    moved = [tuple(frame.flatten().tolist()) not in originals for frame in frames]
    assert sum(moved) >= 16, "most of 49 offsets move an image"
