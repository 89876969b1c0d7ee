"""Heads: what turns features into a distribution over action chunks, one file a kind."""

from playlearn.policies.heads.autoregressive import AutoregressiveConfig
from playlearn.policies.heads.base import Generators, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.cvae import CVAEConfig
from playlearn.policies.heads.deterministic import DeterministicConfig
from playlearn.policies.heads.diffusion import DiffusionConfig
from playlearn.policies.heads.fast import FastConfig
from playlearn.policies.heads.flow import FlowConfig
from playlearn.policies.heads.gaussian import GaussianConfig
from playlearn.policies.heads.guidance import Guidance, guided
from playlearn.policies.heads.latent_plan import LatentPlanConfig
from playlearn.policies.heads.logistic import LogisticConfig
from playlearn.policies.heads.mog import MixtureConfig

__all__ = [
    "AutoregressiveConfig",
    "CVAEConfig",
    "DeterministicConfig",
    "DiffusionConfig",
    "FastConfig",
    "FlowConfig",
    "GaussianConfig",
    "Generators",
    "Guidance",
    "Head",
    "HeadConfig",
    "LatentPlanConfig",
    "LogisticConfig",
    "MixtureConfig",
    "draw_noise",
    "guided",
    "masked_mean",
]
