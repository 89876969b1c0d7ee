"""Normalization to zero mean and unit std, and back; the statistics are saved with the checkpoint."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from playlearn.batch import Statistics
from playlearn.layout import ObjectLayout


class Normalizer(nn.Module):
    """Per-dimension (x - mean) / std for `state`, `achieved` and `action`.

    A dimension that does not vary (see `Statistics.varies`), or whose std is below `floor`, is only shifted: dividing
    by a tiny std would amplify rounding noise to the size of a signal. Actions all lie in [-1, 1], so their stds
    compare. An action that is hardly used (the tilt of a gripper that stays upright) counts as having at least
    `min_action_std` times the largest std, or it would weigh as much in the loss as the others.
    """

    def __init__(self, statistics: Mapping[str, Statistics], floor: float = 1e-4, min_action_std: float = 0.25) -> None:
        super().__init__()
        for name, given in statistics.items():
            std = torch.as_tensor(np.where(given.varies, given.std, 0), dtype=torch.float32)
            if name == "action":
                std = std.clamp_min(min_action_std * std.max())
            self.register_buffer(f"{name}_mean", torch.as_tensor(given.mean, dtype=torch.float32).clone())
            self.register_buffer(f"{name}_std", torch.where(std < floor, torch.ones_like(std), std))

    def normalize(self, name: str, value: Tensor) -> Tensor:
        """(..., N) in units of the data -> (..., N) of about unit std."""
        return (value - self.get_buffer(f"{name}_mean")) / self.get_buffer(f"{name}_std")

    def restore(self, name: str, value: Tensor) -> Tensor:
        """The inverse of `normalize`."""
        return value * self.get_buffer(f"{name}_std") + self.get_buffer(f"{name}_mean")

    @classmethod
    def identity(cls, widths: Mapping[str, int]) -> "Normalizer":
        """One that changes nothing: the shapes to load a checkpoint's statistics into."""
        return cls({name: Statistics(np.zeros(n), np.ones(n)) for name, n in widths.items()})


def pooled(statistics: Mapping[str, Statistics], names: Mapping[str, tuple[str, ...]]) -> dict[str, Statistics]:
    """The same, with one mean and std for all dimensions of one quantity (`red.x`, `eef.x`).

    Then a normalized difference of two of them means the same distance, whichever two they are. Those that vary
    decide. One that does not (a button's place) takes what they have; it is left as it is where none of them varies.
    """
    varies = {array: given.varies for array, given in statistics.items()}
    rows = [(array, i, part) for array, own in names.items() for i, part in enumerate(ObjectLayout(own).quantities)]
    made = {array: Statistics(np.array(given.mean), np.array(given.std)) for array, given in statistics.items()}
    for part in dict.fromkeys(part for _, _, part in rows):
        own = [(array, i) for array, i, other in rows if other == part]
        moving = [(array, i) for array, i in own if varies[array][i]]
        if not moving:
            continue
        means = np.array([statistics[array].mean[i] for array, i in moving], float)
        stds = np.array([statistics[array].std[i] for array, i in moving], float)
        for array, i in own:
            made[array].mean[i] = means.mean()
            made[array].std[i] = np.sqrt((stds**2 + (means - means.mean()) ** 2).mean())
    return made
