"""What every head offers: features in, a distribution over chunks of normalized actions out."""

from collections.abc import Sequence
from dataclasses import dataclass

import draccus
import torch
from torch import Tensor, nn

Generators = torch.Generator | Sequence[torch.Generator]


@dataclass(frozen=True)
class HeadConfig(draccus.ChoiceRegistry):
    """The base of every head's config; `type:` in a YAML picks the kind."""

    def build(self, width: int, chunk: int, actions: int) -> "Head":
        """width: D of the features; chunk: H; actions: A."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Guidance:
    """Classifier-free guidance (Ho and Salimans, 2022): what the goal adds to the prediction, times `weight`.

    features: (B, D) of the same examples without their goal. A weight of 0 forgets the goal, 1 is the
    plain prediction, more exaggerates what the goal asks for.
    """

    features: Tensor
    weight: float

    def combine(self, with_goal: Tensor, without_goal: Tensor) -> Tensor:
        return without_goal + self.weight * (with_goal - without_goal)


class Head(nn.Module):
    """A distribution over (H, A) chunks in normalized action space.

    updates: how many training has made, for what warms up; beyond any warm-up where nobody trains.
    keep: chunks in a row that are to be sampled with the same noise, so that one choice lasts so long.
    """

    updates: int = 10**9
    noise_repeat: int = 1

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Look at (n, H, A) normalized chunks of the training data, once, before the first update."""

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """From (B, D), (B, H, A) and (B, H) bool to a scalar and what to log; masked actions count for nothing."""
        raise NotImplementedError

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        """(B, D) -> (B, H, A). A sequence of B generators gives each row noise of its own, whatever its neighbors."""
        raise NotImplementedError

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """(B, D) -> (B, H, A), the chunk to show where no randomness is wanted."""
        raise NotImplementedError


def masked_mean(error: Tensor, mask: Tensor) -> Tensor:
    """Mean of error (..., H, A) over the actions whose mask (..., H) is True; 0 where none is."""
    weight = mask.unsqueeze(-1).expand_as(error)  # (..., H, A)
    # where(), not a product: a masked action may be anything, NaN included
    return torch.where(weight, error, 0.0).sum() / weight.sum().clamp(min=1)


def draw_noise(shape: Sequence[int], generator: Generators, device: torch.device) -> Tensor:
    """Standard normal (B, ...) from one generator, or row by row from B of them."""
    if isinstance(generator, torch.Generator):
        return torch.randn(tuple(shape), generator=generator, device=generator.device).to(device)
    rows = [torch.randn(tuple(shape[1:]), generator=one, device=one.device) for one in generator]
    return torch.stack(rows).to(device)
