"""The exponential moving average of a policy's weights: what is evaluated and saved."""

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


def averaged(model: nn.Module, decay: float) -> AveragedModel:
    """A copy of `model` that follows it at each `update_parameters(model)`.

    After n updates the decay is min(decay, (1 + n) / (10 + n)), so that the initial weights do not
    dominate a short run.
    """

    @torch.no_grad()
    def follow(mine: list[Tensor], theirs: list[Tensor], updates: Tensor) -> None:
        n = float(updates)
        torch._foreach_lerp_(mine, theirs, 1 - min(decay, (1 + n) / (10 + n)))

    return AveragedModel(model, multi_avg_fn=follow)  # type: ignore[arg-type]
