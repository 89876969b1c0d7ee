"""What diffusion and flow matching share: trained on noised chunks, sampled by leading noise to a chunk."""

from collections.abc import Callable

import torch
from torch import Tensor

from playlearn.policies.heads.base import Generators, Head, draw_noise, masked_mean
from playlearn.policies.heads.denoiser import Denoiser
from playlearn.policies.heads.guidance import Guidance, guided


class DenoisingHead(Head):
    """A kind adds its `network`, what that is trained on (`_noised`) and how it is followed from noise (`_denoise`)."""

    def __init__(self, shape: tuple[int, int], times: int, noise_draws: int) -> None:
        """shape: H, A. times: values that time takes, from 0. noise_draws: noised copies of a chunk in an update."""
        super().__init__()
        self.shape, self.times, self.noise_draws = shape, times, noise_draws

    @property
    def network(self) -> Denoiser:
        """(N, B, H A) noisy chunks, (N, B) times, (B, D) features -> (N, B, H A) predictions."""
        raise NotImplementedError

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator, updates: int | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        draws = self.noise_draws
        # a masked action must not even reach the network's input
        clean = torch.where(mask.unsqueeze(-1), chunk, 0.0).expand(draws, *chunk.shape)  # (N, B, H, A)
        noise = draw_noise(clean.shape, generator, chunk.device)
        time = torch.randint(self.times, (draws, len(chunk)), generator=generator, device=generator.device)
        time = time.to(chunk.device)
        noisy, target = self._noised(clean, noise, time)
        predicted = self.network(noisy.flatten(2), time, features).view_as(clean)
        return masked_mean((predicted - target).square(), mask.expand(draws, *mask.shape)), {}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        noise = draw_noise((len(features), *self.shape), generator, features.device)
        return self._denoise(noise, self._predictor(features, guidance))

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The chunk that the most likely noise (zero) leads to."""
        noise = features.new_zeros(len(features), *self.shape)
        return self._denoise(noise, self._predictor(features, guidance))

    def _noised(self, clean: Tensor, noise: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        """(N, B, H, A) clean chunks and noise, (N, B) times -> noisy chunks and what is to be predicted of them."""
        raise NotImplementedError

    def _denoise(self, noise: Tensor, predict: Callable[[Tensor, int], Tensor]) -> Tensor:
        """(B, H, A) noise -> chunks; predict: from (B, H, A) noisy chunks, all at one time, to (B, H, A)."""
        raise NotImplementedError

    def _predictor(self, features: Tensor, guidance: Guidance | None) -> Callable[[Tensor, int], Tensor]:
        def predict(noisy: Tensor, at: int) -> Tensor:
            time = torch.full((1, 1), at, device=noisy.device)
            flat = noisy.flatten(1).unsqueeze(0)  # (1, B, H A)
            predicted = guided(lambda given: self.network(flat, time, given), features, guidance)
            return predicted[0].view_as(noisy)

        return predict
