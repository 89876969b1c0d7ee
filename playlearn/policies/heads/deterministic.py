"""One chunk, regressed: quick to train, and the mean (or median) of the data's chunks."""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from playlearn.policies.heads.base import Generators, Head, HeadConfig, masked_mean
from playlearn.policies.heads.guidance import Guidance, guided


@HeadConfig.register_subclass("deterministic")
@dataclass(frozen=True)
class DeterministicConfig(HeadConfig):
    """Regression of one chunk.

    loss: `l1` (the median, sharper where data has two modes) or `mse` (the mean).
    hidden: units of the hidden layer (0: a linear map).
    """

    loss: Literal["l1", "mse"] = "l1"
    hidden: int = 256

    unimodal = True

    def build(self, width: int, chunk: int, actions: int) -> "DeterministicHead":
        return DeterministicHead(self, width, chunk, actions)


class DeterministicHead(Head):
    def __init__(self, config: DeterministicConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.shape = (chunk, actions)
        out = chunk * actions
        self.net = (
            nn.Sequential(nn.Linear(width, config.hidden), nn.GELU(), nn.Linear(config.hidden, out))
            if config.hidden
            else nn.Sequential(nn.Linear(width, out))
        )

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        error = self._predict(features) - chunk
        loss = masked_mean(error.abs() if self.config.loss == "l1" else error.square(), mask)
        return loss, {}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        return self.mode(features, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        return guided(self._predict, features, guidance)

    def _predict(self, features: Tensor) -> Tensor:
        chunk: Tensor = self.net(features).unflatten(-1, self.shape)  # (B, H, A)
        return chunk
