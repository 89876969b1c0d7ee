"""A mixture of Gaussians over whole chunks (Bishop, 1994): several modes, each with its weight and its std."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise
from playlearn.policies.heads.guidance import Guidance, guided


@HeadConfig.register_subclass("mog")
@dataclass(frozen=True)
class MixtureConfig(HeadConfig):
    """A mixture of Gaussians over chunks.

    components: K.
    hidden: units of the hidden layer.
    std_range: least and greatest standard deviation, in those of the data. Without a minimum std the NLL is won by
        near-constant dimensions (the gripper), not by informative ones, since scripted labels scatter little: a
        minimum of 0.02 cost most of the goals.
    temperature: of sampling: sharpens (< 1) or flattens the components' weights, and scales their std.
    """

    components: int = 5
    hidden: int = 256
    std_range: tuple[float, float] = (0.1, 2.0)
    temperature: float = 1.0

    @property
    def unimodal(self) -> bool:
        return self.components == 1

    def build(self, width: int, chunk: int, actions: int) -> "MixtureHead":
        return MixtureHead(self, width, chunk, actions, Gaussian())


@dataclass(frozen=True, eq=False)
class Mixture:
    """logits (B, K), mean and log_std (B, K, H, A)."""

    logits: Tensor
    mean: Tensor
    log_std: Tensor


class ComponentDistribution(nn.Module):
    """How a number is distributed about a component's mean; mean and log_std (..., H, A)."""

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """As of `Head`."""

    def log_prob(self, shown: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
        """(..., H, A) log density of each number, for a loss: finite everywhere."""
        raise NotImplementedError

    def possible(self, shown: Tensor) -> Tensor:
        """(..., H, A) bool, whether the number has a density above 0."""
        return torch.ones_like(shown, dtype=torch.bool)

    def draw(self, mean: Tensor, std: Tensor, normal: Tensor) -> Tensor:
        """(B, H, A) draws, made of standard normal numbers."""
        raise NotImplementedError

    def nearest(self, numbers: Tensor) -> Tensor:
        """The nearest possible number to each."""
        return numbers


class Gaussian(ComponentDistribution):
    def log_prob(self, shown: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
        off = (shown - mean) / log_std.exp()
        return -0.5 * off.square() - log_std - 0.5 * math.log(2 * math.pi)

    def draw(self, mean: Tensor, std: Tensor, normal: Tensor) -> Tensor:
        return mean + std * normal


class MixtureHead(Head):
    def __init__(self, config: MixtureConfig, width: int, chunk: int, actions: int, law: ComponentDistribution) -> None:
        super().__init__()
        self.config, self.law = config, law
        self.shape = (config.components, chunk, actions)
        self.sizes = (config.components, math.prod(self.shape), math.prod(self.shape))
        self.net = nn.Sequential(nn.Linear(width, config.hidden), nn.GELU(), nn.Linear(config.hidden, sum(self.sizes)))

    def fit_action_statistics(self, chunks: Tensor) -> None:
        self.law.fit_action_statistics(chunks)

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Negative log-likelihood in nats a number (each of the chunk's A numbers at each step)."""
        numbers = (mask.sum() * self.shape[-1]).clamp(min=1)
        mixture = self._mixture(features, None)
        weights = mixture.logits.softmax(-1)
        used = torch.exp(-(weights * weights.clamp(min=1e-9).log()).sum(-1)).mean()
        return -self._log_prob(mixture, chunk, mask).sum() / numbers, {"components_used": used}

    def log_prob(self, features: Tensor, chunk: Tensor, mask: Tensor) -> Tensor:
        """(B,) log density of the actions whose `mask` (B, H) is True, in normalized action space."""
        impossible = (~self.law.possible(chunk)).any(-1) & mask  # (B, H)
        return self._log_prob(self._mixture(features, None), chunk, mask).masked_fill(impossible.any(1), -torch.inf)

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        mixture, temperature = self._mixture(features, guidance), self.config.temperature
        gumbel = _gumbel(draw_noise(mixture.logits.shape, generator, features.device))
        chosen = (mixture.logits / temperature + gumbel).argmax(-1)  # (B,), drawn by the weights
        noise = draw_noise((len(features), *self.shape[1:]), generator, features.device)
        return self.law.draw(_of(mixture.mean, chosen), temperature * _of(mixture.log_std, chosen).exp(), noise)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The center of the component whose peak is the highest."""
        mixture = self._mixture(features, guidance)
        peak = mixture.logits - mixture.log_std.sum((-2, -1))
        return self.law.nearest(_of(mixture.mean, peak.argmax(-1)))

    def _log_prob(self, mixture: Mixture, chunk: Tensor, mask: Tensor) -> Tensor:
        # where(), not a product: a masked action may be anything, NaN included
        shown = torch.where(mask.unsqueeze(-1), chunk, 0.0).unsqueeze(1)  # (B, 1, H, A)
        each = self.law.log_prob(shown, mixture.mean, mixture.log_std)  # (B, K, H, A)
        whole = torch.where(mask[:, None, :, None], each, 0.0).sum((-2, -1))
        weights = torch.where(mask.any(1, keepdim=True), mixture.logits.log_softmax(-1), 0.0)
        total = torch.logsumexp(weights + whole, dim=-1)
        return torch.where(mask.any(1), total, 0.0)

    def _mixture(self, features: Tensor, guidance: Guidance | None) -> Mixture:
        logits, mean, std = guided(self.net, features, guidance).split(self.sizes, dim=-1)
        low, high = (math.log(bound) for bound in self.config.std_range)
        log_std = low + (high - low) * torch.sigmoid(std + 1.0)
        return Mixture(logits, mean.unflatten(-1, self.shape), log_std.unflatten(-1, self.shape))


def _of(values: Tensor, chosen: Tensor) -> Tensor:
    """(B, K, H, A) and (B,) -> (B, H, A)."""
    return values[torch.arange(len(values), device=values.device), chosen]


def _gumbel(normal: Tensor) -> Tensor:
    """Standard normal numbers -> standard Gumbel ones, through their distribution functions."""
    uniform = torch.special.ndtr(normal.double()).clamp(1e-12, 1 - 1e-12)
    return -torch.log(-torch.log(uniform)).to(normal.dtype)
