"""A mixture of discretized logistics (Salimans et al. 2017), the law of play papers (Lynch et al. 2019).

A number is one of `bins` values, and has the share of the logistic distribution that falls into its bin; the first and
the last bin have the tails. As no share is above one, being sure of what hardly scatters is worth no more than that,
where a density without a floor under its scale would grow without end.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.mog import ComponentDistribution, MixtureConfig, MixtureHead

LIMIT = 5.0  # standard deviations that the bins span before `fit` has seen any data


@HeadConfig.register_subclass("logistic")
@dataclass(frozen=True)
class LogisticConfig(HeadConfig):
    """bins: values a number can take, evenly over what the data holds. The others as of the mixture of Gaussians.

    Unlike in the papers, a component speaks of the whole chunk, so that a choice is one for all its numbers.
    """

    components: int = 5
    bins: int = 256
    hidden: int = 256
    scale_range: tuple[float, float] = (0.05, 2.0)
    temperature: float = 1.0

    def build(self, width: int, chunk: int, actions: int) -> MixtureHead:
        mixture = MixtureConfig(self.components, self.hidden, self.scale_range, self.temperature)
        return MixtureHead(mixture, width, chunk, actions, Logistic(self.bins, actions))


class Logistic(ComponentDistribution):
    """low (A,), the first bin's lower edge, and width (A,) of a bin."""

    low: Tensor
    width: Tensor

    def __init__(self, bins: int, actions: int) -> None:
        super().__init__()
        self.bins = bins
        self.register_buffer("low", torch.full((actions,), -LIMIT))
        self.register_buffer("width", torch.full((actions,), 2 * LIMIT / bins))

    def fit_action_statistics(self, chunks: Tensor) -> None:
        values = chunks.flatten(0, -2)
        low, high = values.min(0).values, values.max(0).values
        self.low.copy_(low)
        self.width.copy_((high - low).clamp(min=1e-3) / self.bins)

    def log_prob(self, shown: Tensor, mean: Tensor, log_scale: Tensor) -> Tensor:
        """Log of the share of the number's bin over the bin's width; what is beyond all bins counts to the nearest."""
        place = self._bin(shown)
        below = self.low + place * self.width
        scale = log_scale.exp() * (math.sqrt(3) / math.pi)  # of a logistic that has this standard deviation
        lower, upper = (below - mean) / scale, (below + self.width - mean) / scale
        # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - exp(l - u)), which loses nothing far out
        inner = logsigmoid(upper) + logsigmoid(-lower) + torch.log(-torch.expm1(-self.width / scale))
        first, last = logsigmoid(upper), logsigmoid(-lower)
        share = torch.where(place == 0, first, torch.where(place == self.bins - 1, last, inner))
        return share - self.width.log()

    def possible(self, shown: Tensor) -> Tensor:
        return (shown >= self.low) & (shown <= self.low + self.bins * self.width)

    def draw(self, mean: Tensor, scale: Tensor, normal: Tensor) -> Tensor:
        uniform = torch.special.ndtr(normal.double()).clamp(1e-12, 1 - 1e-12)
        scattered = torch.special.logit(uniform).to(mean.dtype) * (math.sqrt(3) / math.pi)
        return self.nearest(mean + scale * scattered)

    def nearest(self, numbers: Tensor) -> Tensor:
        """The middle of the bin that each falls into."""
        return self.low + (self._bin(numbers) + 0.5) * self.width

    def _bin(self, numbers: Tensor) -> Tensor:
        return ((numbers.detach() - self.low) / self.width).floor().clamp(0, self.bins - 1)
