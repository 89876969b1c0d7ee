"""Numbers to zero mean and unit spread and back; the statistics travel with the checkpoint."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.batch import Statistics
from playlearn.layout import ObjectLayout


class Normalizer(nn.Module):
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

    def normalize(self, name: str, value: Tensor) -> Tensor:
        """(..., N) in units of the data -> (..., N) of about unit spread."""
        return (value - self.get_buffer(f"{name}_mean")) / self.get_buffer(f"{name}_std")

    def restore(self, name: str, value: Tensor) -> Tensor:
        """The inverse of `normalize`."""
        return value * self.get_buffer(f"{name}_std") + self.get_buffer(f"{name}_mean")

    @classmethod
    def identity(cls, widths: Mapping[str, int]) -> "Normalizer":
        """One that changes nothing: the shapes to load a checkpoint's statistics into."""
        return cls({name: Statistics(np.zeros(n), np.ones(n)) for name, n in widths.items()})


def pooled(statistics: Mapping[str, Statistics], names: Mapping[str, tuple[str, ...]]) -> dict[str, Statistics]:
    """The same, with one mean and spread for all quantities that share a part name (`red.x`, `eef.x`).

    Then a difference of two of them means the same distance, whichever two they are.
    """
    rows = [(array, i, part) for array, own in names.items() for i, part in enumerate(ObjectLayout(own).quantities)]
    made = {array: Statistics(np.array(given.mean), np.array(given.std)) for array, given in statistics.items()}
    for part in dict.fromkeys(part for _, _, part in rows):
        own = [(array, i) for array, i, other in rows if other == part]
        means = np.array([statistics[array].mean[i] for array, i in own], float)
        spreads = np.array([statistics[array].std[i] for array, i in own], float)
        for array, i in own:
            made[array].mean[i] = means.mean()
            made[array].std[i] = np.sqrt((spreads**2 + (means - means.mean()) ** 2).mean())
    return made
