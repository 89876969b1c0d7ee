"""A conditional variational autoencoder of chunks (Sohn et al. 2015; for robots Zhao et al. 2023).

A posterior encoder reads the chunk and describes it by a latent z; a decoder turns features and z into a chunk. To
act, z is drawn from the prior N(0, I), which chooses among the possible chunks.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.guidance import Guidance, guided


@HeadConfig.register_subclass("cvae")
@dataclass(frozen=True)
class CVAEConfig(HeadConfig):
    """A conditional variational autoencoder of chunks.

    latent: dimensions of z.
    hidden: units of each hidden layer.
    kl: weight of the divergence from the prior, against the error of one number of the chunk.
    warmup: updates over which that weight rises from 0.
    free: nats per latent dimension that cost nothing (free bits, Kingma et al. 2016), so that the decoder does not
        learn to ignore z.
    """

    latent: int = 8
    hidden: int = 256
    kl: float = 0.01
    warmup: int = 1000
    free: float = 0.05

    def build(self, width: int, chunk: int, actions: int) -> "CVAEHead":
        return CVAEHead(self, width, chunk, actions)


class CVAEHead(Head):
    def __init__(self, config: CVAEConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.shape = (chunk, actions)
        out, hidden = chunk * actions, config.hidden
        self.posterior_encoder = nn.Sequential(
            nn.Linear(width + out + chunk, hidden), nn.GELU(), nn.Linear(hidden, 2 * config.latent)
        )
        self.decoder = nn.Sequential(
            nn.Linear(width + config.latent, hidden),
            nn.GELU(),
            nn.Linear(hidden, hidden),
            nn.GELU(),
            nn.Linear(hidden, out),
        )

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """`z_matters`: relative growth of the error with another example's z; 0 where z is ignored."""
        mean, log_std = self._posterior(features, chunk, mask)
        z = mean + log_std.exp() * draw_noise(mean.shape, generator, mean.device)
        error = masked_mean((self._decode(features, z) - chunk).abs(), mask)
        divergence = 0.5 * (mean.square() + (2 * log_std).exp() - 1) - log_std  # (B, Z) nats
        each = divergence.mean(0)
        warm = 1.0 if updates is None else min(1.0, updates / max(1, self.config.warmup))
        loss = error + self.config.kl * warm * each.clamp(min=self.config.free).sum()
        with torch.no_grad():
            swapped = masked_mean((self._decode(features, z.roll(1, 0)) - chunk).abs(), mask)
        return loss, {"error": error, "kl": each.sum(), "z_matters": swapped / error.clamp(min=1e-9) - 1}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        z = draw_noise((len(features), self.config.latent), generator, features.device)
        return self._guided(features, z, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The chunk of the most likely z."""
        return self._guided(features, features.new_zeros(len(features), self.config.latent), guidance)

    def _posterior(self, features: Tensor, chunk: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation of z, each (B, Z)."""
        shown = torch.where(mask.unsqueeze(-1), chunk, 0.0).flatten(1)
        inputs = torch.cat([features, shown, mask.to(shown.dtype)], dim=-1)
        mean, log_std = self.posterior_encoder(inputs).chunk(2, dim=-1)
        return mean, log_std.clamp(-5, 2)

    def _decode(self, features: Tensor, z: Tensor) -> Tensor:
        chunk: Tensor = self.decoder(torch.cat([features, z], dim=-1)).unflatten(-1, self.shape)
        return chunk

    def _guided(self, features: Tensor, z: Tensor, guidance: Guidance | None) -> Tensor:
        return guided(lambda given: self._decode(given, z), features, guidance)
