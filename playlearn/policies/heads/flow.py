"""Flow matching over action chunks (Lipman et al. 2023; Liu et al. 2023): straight paths from noise to data."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.denoiser import Denoiser
from playlearn.policies.heads.denoising import DenoisingHead

TIMES = 1000  # values of time that the network is given, from 0 (noise) towards 1 (data)


@HeadConfig.register_subclass("flow")
@dataclass(frozen=True)
class FlowConfig(HeadConfig):
    """Flow matching over chunks.

    width: units of a layer of the velocity network, which is built as diffusion's denoiser.
    blocks: residual blocks of the velocity network.
    sample_steps: Euler steps from noise to chunk.
    noise_draws: noised copies of each chunk in one update; the encoder, which costs most, runs once for all of them.
    """

    width: int = 512
    blocks: int = 3
    sample_steps: int = 8
    noise_draws: int = 4

    def build(self, width: int, chunk: int, actions: int) -> "FlowHead":
        return FlowHead(self, width, chunk, actions)


class FlowHead(DenoisingHead):
    """The network predicts the velocity (chunk - noise) at a point of the line between them."""

    def __init__(self, config: FlowConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__((chunk, actions), TIMES, config.noise_draws)
        self.config = config
        self.velocity = Denoiser(config.width, config.blocks, TIMES, width, chunk * actions)

    @property
    def network(self) -> Denoiser:
        return self.velocity

    def _noised(self, clean: Tensor, noise: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        return torch.lerp(noise, clean, (time / TIMES)[..., None, None]), clean - noise

    def _denoise(self, noise: Tensor, predict: Callable[[Tensor, int], Tensor]) -> Tensor:
        point, steps = noise, self.config.sample_steps
        for step in range(steps):
            point = point + predict(point, step * TIMES // steps) / steps
        return point
