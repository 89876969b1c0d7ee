"""Diffusion over action chunks (Ho et al. 2020; Chi et al. 2023): DDPM training, few-step DDIM or DPM-Solver."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from playlearn.policies.heads.base import HeadConfig
from playlearn.policies.heads.denoiser import Denoiser
from playlearn.policies.heads.denoising import DenoisingHead


@HeadConfig.register_subclass("diffusion")
@dataclass(frozen=True)
class DiffusionConfig(HeadConfig):
    """Diffusion over chunks.

    width: units of a layer of the denoiser, an MLP with residual blocks modulated (FiLM) by features and time.
    blocks: residual blocks of the denoiser.
    train_steps: length of the noise schedule.
    schedule: of the noise, by its name in diffusers.
    prediction: what the denoiser outputs: the noise, the clean chunk (`sample`), or the velocity between them.
    sampler: how chunks are drawn.
    sample_steps: denoising steps of a draw.
    noise_draws: noised copies of each chunk in one update; the encoder, which costs most, runs once for all of them.
    clip: bound on the predicted clean chunk, in standard deviations of the data (ddim); wider where the data are.
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


class DiffusionHead(DenoisingHead):
    """reach (): what the predicted clean chunk is clipped to, in standard deviations of the data."""

    reach: Tensor

    def __init__(self, config: DiffusionConfig, width: int, chunk: int, actions: int) -> None:
        super().__init__((chunk, actions), config.train_steps, config.noise_draws)
        # diffusers takes a second to import: only this head pays
        from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

        self.config = config
        self.register_buffer("reach", torch.tensor(config.clip))
        self.denoiser = Denoiser(config.width, config.blocks, config.train_steps, width, chunk * actions)
        self.noiser = DDPMScheduler(
            num_train_timesteps=config.train_steps, beta_schedule=config.schedule, prediction_type=config.prediction
        )

    def fit_action_statistics(self, chunks: Tensor) -> None:
        """Reach as far as the data do: what is rarely other than 0 lies many of its standard deviations away."""
        self.reach.copy_(chunks.abs().max().clamp(min=self.config.clip))

    @property
    def network(self) -> Denoiser:
        return self.denoiser

    def _noised(self, clean: Tensor, noise: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        flat = clean.flatten(0, 1), noise.flatten(0, 1), time.flatten()
        noisy = self.noiser.add_noise(*flat).view_as(clean)
        if self.config.prediction == "sample":
            return noisy, clean
        if self.config.prediction == "epsilon":
            return noisy, noise
        return noisy, self.noiser.get_velocity(*flat).view_as(clean)

    def _denoise(self, noise: Tensor, predict: Callable[[Tensor, int], Tensor]) -> Tensor:
        sampler, noisy = self._sampler(), noise
        for step in sampler.timesteps:
            noisy = sampler.step(predict(noisy, int(step)), step, noisy).prev_sample
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
                **shared, clip_sample=True, clip_sample_range=float(self.reach), timestep_spacing="trailing"
            )
        else:
            sampler = DPMSolverMultistepScheduler(**shared, timestep_spacing="trailing")
        with warnings.catch_warnings():  # diffusers hands tensors to numpy in a way that numpy 2 warns of
            warnings.simplefilter("ignore", DeprecationWarning)
            sampler.set_timesteps(config.sample_steps)
        return sampler
