"""Numbers to zero mean and unit spread and back; the statistics travel with the checkpoint."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.episode import Array


class Statistics(Protocol):
    """Mean and standard deviation of one vector, each (N,)."""

    @property
    def mean(self) -> Array: ...
    @property
    def std(self) -> Array: ...


class Normaliser(nn.Module):
    """Per-dimension (x - mean) / std for `state`, `achieved` and `action`.

    A dimension that hardly varies in the data (std below `floor`) is only shifted: dividing by
    a tiny spread would blow rounding noise up to the size of a signal. Actions all lie in [-1, 1], so
    their spreads compare: one that is hardly used (the tilt of a hand that is kept upright) counts as
    having at least `action_share` of the largest, or it would get as much say in the loss as the rest.
    """

    def __init__(self, statistics: Mapping[str, Statistics], floor: float = 1e-4, action_share: float = 0.25) -> None:
        super().__init__()
        for name, given in statistics.items():
            std = torch.as_tensor(given.std, dtype=torch.float32).clone()
            if name == "action":
                std = std.clamp_min(action_share * std.max())
            self.register_buffer(f"{name}_mean", torch.as_tensor(given.mean, dtype=torch.float32).clone())
            self.register_buffer(f"{name}_std", torch.where(std < floor, torch.ones_like(std), std))

    def normalise(self, name: str, value: Tensor) -> Tensor:
        """(..., N) in units of the data -> (..., N) of about unit spread."""
        return (value - self.get_buffer(f"{name}_mean")) / self.get_buffer(f"{name}_std")

    def restore(self, name: str, value: Tensor) -> Tensor:
        """The inverse of `normalise`."""
        return value * self.get_buffer(f"{name}_std") + self.get_buffer(f"{name}_mean")

    @classmethod
    def identity(cls, widths: Mapping[str, int]) -> "Normaliser":
        """One that changes nothing: the shapes to load a checkpoint's statistics into."""
        return cls({name: _Spread(np.zeros(n), np.ones(n)) for name, n in widths.items()})


class _Spread(NamedTuple):
    mean: Array
    std: Array
