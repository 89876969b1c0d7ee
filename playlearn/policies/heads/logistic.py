"""A mixture of discretized logistics (Salimans et al. 2017), the distribution of play papers (Lynch et al. 2019).

A number is one of `bins` values. Its probability is what the logistic distribution gives its bin; the first and the
last bin have the tails. No probability is above one, so a near-constant dimension is worth no more than that. A
density without a minimum scale would grow without bound there.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.mog import ComponentDistribution, MixtureConfig, MixtureHead

LIMIT = 5.0  # standard deviations that the bins span before `fit_action_statistics`


@HeadConfig.register_subclass("logistic")
@dataclass(frozen=True)
class LogisticConfig(HeadConfig):
    """A mixture of discretized logistics; unlike in the papers a component is of the whole chunk, a single choice.

    components: K.
    bins: values a number can take, evenly over the range of the data.
    hidden: units of the hidden layer.
    scale_range: least and greatest standard deviation, in those of the data.
    temperature: of sampling: sharpens (< 1) or flattens the components' weights, and scales their std.
    """

    components: int = 5
    bins: int = 256
    hidden: int = 256
    scale_range: tuple[float, float] = (0.05, 2.0)
    temperature: float = 1.0

    @property
    def unimodal(self) -> bool:
        return self.components == 1

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
        """Log of the bin's probability over the bin's width; a number beyond all bins counts to the nearest."""
        number = self._bin(shown)
        below = self.low + number * self.width
        scale = log_scale.exp() * (math.sqrt(3) / math.pi)  # of a logistic that has this standard deviation
        lower, upper = (below - mean) / scale, (below + self.width - mean) / scale
        # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - exp(l - u)), which is accurate far out
        inner = logsigmoid(upper) + logsigmoid(-lower) + torch.log(-torch.expm1(-self.width / scale))
        first, last = logsigmoid(upper), logsigmoid(-lower)
        log_probability = torch.where(number == 0, first, torch.where(number == self.bins - 1, last, inner))
        return log_probability - self.width.log()

    def possible(self, shown: Tensor) -> Tensor:
        return (shown >= self.low) & (shown <= self.low + self.bins * self.width)

    def draw(self, mean: Tensor, scale: Tensor, normal: Tensor) -> Tensor:
        uniform = torch.special.ndtr(normal.double()).clamp(1e-12, 1 - 1e-12)
        standard = torch.special.logit(uniform).to(mean.dtype) * (math.sqrt(3) / math.pi)
        return self.nearest(mean + scale * standard)

    def nearest(self, numbers: Tensor) -> Tensor:
        """The middle of the bin that each falls into."""
        return self.low + (self._bin(numbers) + 0.5) * self.width

    def _bin(self, numbers: Tensor) -> Tensor:
        return ((numbers.detach() - self.low) / self.width).floor().clamp(0, self.bins - 1)
