"""Residual layers over the concatenated tokens: the quickest trunk where the history is short."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.policies.trunks.base import Trunk, TrunkConfig


@TrunkConfig.register_subclass("mlp")
@dataclass(frozen=True)
class MLPConfig(TrunkConfig):
    """A residual MLP.

    width: D, of tokens and features.
    layers: residual layers.
    hidden: units of each.
    """

    layers: int = 2
    hidden: int = 512

    def build(self, tokens: int) -> "MLP":
        return MLP(self, tokens)


class MLP(Trunk):
    def __init__(self, config: MLPConfig, tokens: int) -> None:
        super().__init__()
        self.in_proj = nn.Linear(tokens * config.width, config.hidden)
        self.layers = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(config.hidden), nn.Linear(config.hidden, config.hidden), nn.GELU())
            for _ in range(config.layers)
        )
        self.out_proj = nn.Sequential(nn.LayerNorm(config.hidden), nn.Linear(config.hidden, config.width))

    def forward(self, tokens: Tensor, mask: Tensor | None) -> Tensor:
        if mask is not None:
            tokens = torch.where(mask.unsqueeze(-1), tokens, 0.0)
        hidden = self.in_proj(tokens.flatten(1))  # (B, hidden)
        for layer in self.layers:
            hidden = hidden + layer(hidden)
        features: Tensor = self.out_proj(hidden)  # (B, D)
        return features
