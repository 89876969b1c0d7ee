"""An LSTM over goal and history tokens; play was first learned with recurrent networks (Lynch et al. 2019)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.policies.trunks.base import Trunk, TrunkConfig


@TrunkConfig.register_subclass("lstm")
@dataclass(frozen=True)
class LSTMConfig(TrunkConfig):
    """An LSTM.

    width: D, of tokens and features.
    layers: recurrent layers of `width` units.
    """

    layers: int = 2

    def build(self, tokens: int) -> "LSTM":
        return LSTM(self)


class LSTM(Trunk):
    def __init__(self, config: LSTMConfig) -> None:
        super().__init__()
        self.net = nn.LSTM(config.width, config.width, config.layers, batch_first=True)

    def forward(self, tokens: Tensor, mask: Tensor | None) -> Tensor:
        if mask is None:
            last: Tensor = self.net(tokens)[0][:, -1]  # (B, D)
            return last
        # Padding goes to the end, after the output that is read.
        order = (~mask).to(torch.int8).argsort(dim=1, stable=True)
        out = self.net(tokens.gather(1, order.unsqueeze(-1).expand_as(tokens)))[0]
        present: Tensor = out[torch.arange(len(out), device=out.device), mask.sum(1) - 1]
        return present
