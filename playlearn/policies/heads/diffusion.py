"""Diffusion over action chunks (Ho et al. 2020; Chi et al. 2023): DDPM training, few-step DDIM or DPM-Solver."""

import warnings
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.denoiser import Denoiser


@HeadConfig.register_subclass("diffusion")
@dataclass(frozen=True)
class DiffusionConfig(HeadConfig):
    """width, blocks: size of the denoiser, an MLP with residual blocks modulated (FiLM) by features and time.

    train_steps: length of the noise schedule. prediction: what the denoiser outputs.
    sampler, sample_steps: how chunks are drawn. noise_draws: noised copies of each chunk in one update;
    the encoder, which costs most, runs once for all of them. clip: bound on the predicted clean chunk,
    in standard deviations of the data.
    """

    width: int = 512
    blocks: int = 3
    train_steps: int = 100
    schedule: Literal["squaredcos_cap_v2", "linear", "scaled_linear"] = "squaredcos_cap_v2"
    prediction: Literal["epsilon", "sample", "v_prediction"] = "sample"
    sampler: Literal["ddim", "dpm"] = "ddim"
    sample_steps: int = 8
    noise_draws: int = 4
    clip: float = 5.0

    def build(self, width: int, chunk: int, actions: int) -> "DiffusionHead":
        return DiffusionHead(self, width, chunk, actions)


class DiffusionHead(Head):
    def __init__(self, config: DiffusionConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__()
        # diffusers takes a second to import: only who builds this head pays
        from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

        self.config = config
        self.shape = (chunk, actions)
        self.denoiser = Denoiser(config.width, config.blocks, config.train_steps, width, chunk * actions)
        self.noiser = DDPMScheduler(
            num_train_timesteps=config.train_steps, beta_schedule=config.schedule, prediction_type=config.prediction
        )

    def loss(
        self, features: Tensor, chunk: Tensor, mask: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        draws, batch = self.config.noise_draws, len(chunk)
        # a masked action must not even reach the denoiser's input
        clean = torch.where(mask.unsqueeze(-1), chunk, 0.0).expand(draws, *chunk.shape)  # (N, B, H, A)
        noise = draw_noise(clean.shape, generator, chunk.device)
        time = torch.randint(self.config.train_steps, (draws, batch), generator=generator, device=generator.device)
        time = time.to(chunk.device)
        noisy = self.noiser.add_noise(clean.flatten(0, 1), noise.flatten(0, 1), time.flatten()).view_as(clean)
        predicted = self.denoiser(noisy.flatten(2), time, features).view_as(clean)
        error = (predicted - self._target(clean, noise, time)).square()
        return masked_mean(error, mask.expand(draws, *mask.shape)), {}

    def sample(self, features: Tensor, generator: Generators, guidance: Guidance | None = None) -> Tensor:
        noise = draw_noise((len(features), *self.shape), generator, features.device)
        return self._denoise(noise, features, guidance)

    def mode(self, features: Tensor, guidance: Guidance | None = None) -> Tensor:
        """The chunk that the most likely noise (zero) leads to."""
        return self._denoise(features.new_zeros(len(features), *self.shape), features, guidance)

    def _target(self, clean: Tensor, noise: Tensor, time: Tensor) -> Tensor:
        if self.config.prediction == "sample":
            return clean
        if self.config.prediction == "epsilon":
            return noise
        flat: Tensor = self.noiser.get_velocity(clean.flatten(0, 1), noise.flatten(0, 1), time.flatten())
        return flat.view_as(clean)

    def _denoise(self, noisy: Tensor, features: Tensor, guidance: Guidance | None) -> Tensor:
        sampler = self._sampler()
        for step in sampler.timesteps:
            time = torch.full((1, 1), int(step), device=noisy.device)
            flat = noisy.flatten(1).unsqueeze(0)  # (1, B, H A)
            predicted = self.denoiser(flat, time, features)
            if guidance is not None:
                predicted = guidance.combine(predicted, self.denoiser(flat, time, guidance.features))
            noisy = sampler.step(predicted[0].view_as(noisy), step, noisy).prev_sample
        return noisy

    def _sampler(self) -> Any:
        from diffusers.schedulers.scheduling_ddim import DDIMScheduler
        from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler

        config = self.config
        shared = {
            "num_train_timesteps": config.train_steps,
            "beta_schedule": config.schedule,
            "prediction_type": config.prediction,
        }
        sampler: Any
        if config.sampler == "ddim":
            # trailing spacing starts from the noisiest step, as sampling itself does
            sampler = DDIMScheduler(
                **shared, clip_sample=True, clip_sample_range=config.clip, timestep_spacing="trailing"
            )
        else:
            sampler = DPMSolverMultistepScheduler(**shared, timestep_spacing="trailing")
        with warnings.catch_warnings():  # diffusers hands tensors to numpy in a way that numpy 2 warns of
            warnings.simplefilter("ignore", DeprecationWarning)
            sampler.set_timesteps(config.sample_steps)
        return sampler
