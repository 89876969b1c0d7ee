"""Flow matching over action chunks (Lipman et al. 2023; Liu et al. 2023): straight paths from noise to data."""

from dataclasses import dataclass

import torch
from torch import Tensor

from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.denoiser import Denoiser

TIMES = 1000  # how finely time, from 0 (noise) to 1 (data), is told to the network


@HeadConfig.register_subclass("flow")
@dataclass(frozen=True)
class FlowConfig(HeadConfig):
    """width, blocks: size of the velocity network. sample_steps: Euler steps from noise to chunk.

    noise_draws: noised copies of each chunk in one update; the encoder, which costs most, runs once for all.
    """

    width: int = 512
    blocks: int = 3
    sample_steps: int = 8
    noise_draws: int = 4

    def build(self, width: int, chunk: int, actions: int) -> "FlowHead":
        return FlowHead(self, width, chunk, actions)


class FlowHead(Head):
    """The network predicts the velocity (chunk - noise) at a point of the line between them."""

    def __init__(self, config: FlowConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.shape = (chunk, actions)
        self.velocity = Denoiser(config.width, config.blocks, TIMES, width, chunk * actions)

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        draws, batch = self.config.noise_draws, len(chunk)
        # a masked action must not even reach the network's input
        clean = torch.where(mask.unsqueeze(-1), chunk, 0.0).expand(draws, *chunk.shape)  # (N, B, H, A)
        noise = draw_noise(clean.shape, generator, chunk.device)
        time = torch.randint(TIMES, (draws, batch), generator=generator, device=generator.device).to(chunk.device)
        share = (time / TIMES)[..., None, None]
        predicted = self.velocity(torch.lerp(noise, clean, share).flatten(2), time, features).view_as(clean)
        return masked_mean((predicted - (clean - noise)).square(), mask.expand(draws, *mask.shape)), {}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        noise = draw_noise((len(features), *self.shape), generator, features.device)
        return self._follow(noise, features, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The chunk that the most likely noise (zero) leads to."""
        return self._follow(features.new_zeros(len(features), *self.shape), features, guidance)

    def _follow(self, point: Tensor, features: Tensor, guidance: Guidance | None) -> Tensor:
        steps = self.config.sample_steps
        for step in range(steps):
            time = torch.full((1, 1), step * TIMES // steps, device=point.device)
            flat = point.flatten(1).unsqueeze(0)  # (1, B, H A)
            velocity = self.velocity(flat, time, features)
            if guidance is not None:
                velocity = guidance.combine(velocity, self.velocity(flat, time, guidance.features))
            point = point + velocity[0].view_as(point) / steps
        return point
