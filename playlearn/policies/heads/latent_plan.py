"""Latent plans from play (Lynch et al. 2019): a chunk of play, summarized by a posterior encoder that sees all of it.

The window is the chunk. In training, plan recognition (a posterior encoder) reads all of it and describes it by a plan
z. Plan proposal, which sees only the present and the goal, learns to propose such plans, and a decoder turns a plan
into actions. To act, a plan is drawn from the proposal, and its noise is kept for `noise_repeat` chunks. The choice
among several possible plans is then one, while the plan follows what is observed.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.guidance import Guidance, guided


@HeadConfig.register_subclass("latent_plan")
@dataclass(frozen=True)
class LatentPlanConfig(HeadConfig):
    """Latent plans.

    latent: dimensions of a plan.
    hidden: units of each hidden layer.
    noise_repeat: consecutive chunks that are sampled with the same noise.
    kl: weight of the divergence of recognition and proposal, against the error of one number of the chunk.
    balance: fraction of the divergence that moves the proposal towards the recognition, rather than the other way
        round (KL balancing, Hafner et al. 2021).
    free: nats per latent dimension that cost nothing (free bits).
    """

    latent: int = 16
    hidden: int = 256
    noise_repeat: int = 2
    kl: float = 0.01
    balance: float = 0.8
    free: float = 0.02

    def build(self, width: int, chunk: int, actions: int) -> "LatentPlanHead":
        return LatentPlanHead(self, width, chunk, actions)


@dataclass(frozen=True, eq=False)
class _Plans:
    """A normal distribution over plans: mean and log standard deviation, each (B, Z)."""

    mean: Tensor
    log_std: Tensor

    def draw(self, noise: Tensor) -> Tensor:
        return self.mean + self.log_std.exp() * noise

    def detached(self) -> "_Plans":
        return _Plans(self.mean.detach(), self.log_std.detach())


class LatentPlanHead(Head):
    def __init__(self, config: LatentPlanConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.noise_repeat = config.noise_repeat
        self.shape = (chunk, actions)
        hidden, latent = config.hidden, config.latent
        # Both ways along the window: a plan depends on all of it.
        self.reader = nn.GRU(actions + 1, hidden // 2, batch_first=True, bidirectional=True)
        self.plan_recognition = _mlp(width + hidden, hidden, 2 * latent)
        self.plan_proposal = _mlp(width, hidden, 2 * latent)
        self.decoder = nn.Sequential(
            _mlp(width + latent, hidden, hidden), nn.GELU(), nn.Linear(hidden, chunk * actions)
        )

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """`proposed`: the error with the proposed plan, which is what the policy acts by."""
        config = self.config
        recognized, proposed = self._recognize(features, chunk, mask), _plans(self.plan_proposal(features))
        noise = draw_noise(recognized.mean.shape, generator, recognized.mean.device)
        error = masked_mean((self._decode(features, recognized.draw(noise)) - chunk).abs(), mask)
        forward, back = _divergence(recognized.detached(), proposed), _divergence(recognized, proposed.detached())
        divergence = config.balance * forward.clamp(min=config.free) + (1 - config.balance) * back.clamp(
            min=config.free
        )
        with torch.no_grad():
            without = masked_mean((self._decode(features, proposed.draw(noise)) - chunk).abs(), mask)
        metrics = {"error": error, "proposed": without, "kl": back.sum()}
        return error + config.kl * divergence.sum(), metrics

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        noise = draw_noise((len(features), self.config.latent), generator, features.device)
        return self._act(features, noise, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The chunk of the likeliest plan."""
        return self._act(features, features.new_zeros(len(features), self.config.latent), guidance)

    def _act(self, features: Tensor, noise: Tensor, guidance: Guidance | None) -> Tensor:
        def chunk(given: Tensor) -> Tensor:
            return self._decode(given, _plans(self.plan_proposal(given)).draw(noise))

        return guided(chunk, features, guidance)

    def _recognize(self, features: Tensor, chunk: Tensor, mask: Tensor) -> _Plans:
        shown = torch.where(mask.unsqueeze(-1), chunk, 0.0)
        read = self.reader(torch.cat([shown, mask.unsqueeze(-1).to(shown.dtype)], dim=-1))[0].mean(1)  # (B, hidden)
        return _plans(self.plan_recognition(torch.cat([features, read], dim=-1)))

    def _decode(self, features: Tensor, plan: Tensor) -> Tensor:
        chunk: Tensor = self.decoder(torch.cat([features, plan], dim=-1)).unflatten(-1, self.shape)
        return chunk


def _mlp(inputs: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, out))


def _plans(parameters: Tensor) -> _Plans:
    mean, log_std = parameters.chunk(2, dim=-1)
    return _Plans(mean, log_std.clamp(-5, 2))


def _divergence(one: _Plans, other: _Plans) -> Tensor:
    """(Z,) Kullback-Leibler divergence of `one` from `other` in nats, the mean over the batch."""
    ratio = 2 * (one.log_std - other.log_std)
    off = (one.mean - other.mean) / other.log_std.exp()
    return (0.5 * (ratio.exp() + off.square() - 1 - ratio)).mean(0)
