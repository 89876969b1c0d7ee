"""What every trunk offers: a sequence of tokens in, the features of the present moment out."""

from dataclasses import dataclass

import draccus
from torch import Tensor, nn


@dataclass(frozen=True)
class TrunkConfig(draccus.ChoiceRegistry):
    """The base of every trunk's config; `type:` in a YAML picks the kind.

    width: D, of tokens and features.
    """

    width: int = 256

    def build(self, tokens: int) -> "Trunk":
        """tokens: N, those of the goal and of the whole history."""
        raise NotImplementedError


class Trunk(nn.Module):
    """(B, N, D) tokens, the goal first, then the history from old to new -> (B, D) features."""

    def forward(self, tokens: Tensor, mask: Tensor | None) -> Tensor:
        """mask: (B, N) bool, False for tokens of padded history; None where nothing is padded."""
        raise NotImplementedError
