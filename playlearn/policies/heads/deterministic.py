"""One chunk, regressed: quick to learn, and the mean (or median) of what the data did."""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, masked_mean


@HeadConfig.register_subclass("deterministic")
@dataclass(frozen=True)
class DeterministicConfig(HeadConfig):
    """loss: `l1` (the median, sharper where data has two modes) or `mse` (the mean). hidden: units, 0: a linear map."""

    loss: Literal["l1", "mse"] = "l1"
    hidden: int = 256

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
        self,
        features: Tensor,
        chunk: Tensor,
        mask: Tensor,
        generator: torch.Generator,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        error = self._predict(features) - chunk
        loss = masked_mean(error.abs() if self.config.loss == "l1" else error.square(), mask)
        return loss, {}

    def sample(
        self,
        features: Tensor,
        generator: Generators,
        guidance: Guidance | None = None,
    ) -> Tensor:
        return self.mode(features, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        chunk = self._predict(features)
        return chunk if guidance is None else guidance.combine(chunk, self._predict(guidance.features))

    def _predict(self, features: Tensor) -> Tensor:
        chunk: Tensor = self.net(features).unflatten(-1, self.shape)  # (B, H, A)
        return chunk
