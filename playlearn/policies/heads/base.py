"""What every head offers: features in, a distribution over chunks of normalized actions out."""

from collections.abc import Sequence
from dataclasses import dataclass

import draccus
import torch
from torch import Tensor, nn

from playlearn.policies.heads.guidance import Guidance

Generators = torch.Generator | Sequence[torch.Generator]


@dataclass(frozen=True)
class HeadConfig(draccus.ChoiceRegistry):
    """The base of every head's config; `type:` in a YAML picks the kind."""

    @property
    def unimodal(self) -> bool:
        """Whether the distribution has a single mode, so that of two equally good chunks it makes their mean."""
        return False

    def build(self, width: int, chunk: int, actions: int) -> "Head":
        """width: D of the features; chunk: H; actions: A."""
        raise NotImplementedError


class Head(nn.Module):
    """A distribution over (H, A) chunks in normalized action space; complete when built.

    noise_repeat: consecutive chunks that are sampled with the same noise, so that one choice lasts so long.
    """

    noise_repeat: int = 1

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Look at (n, H, A) normalized chunks of the training data, once, before the first update."""

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """From (B, D), (B, H, A) and (B, H) bool to a scalar and what to log; masked actions do not contribute.

        updates: made so far in this training, for what warms up; None outside training, after every warm-up.
        """
        raise NotImplementedError

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        """(B, D) -> (B, H, A). With a sequence of B generators, a row's noise does not depend on the other rows."""
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
