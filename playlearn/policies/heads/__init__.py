"""Heads: what turns features into a distribution over action chunks, one file a kind."""

from playlearn.policies.heads.base import Generators, Guidance, Head, HeadConfig, draw_noise, masked_mean
from playlearn.policies.heads.deterministic import DeterministicConfig
from playlearn.policies.heads.diffusion import DiffusionConfig

__all__ = [
    "DeterministicConfig",
    "DiffusionConfig",
    "Generators",
    "Guidance",
    "Head",
    "HeadConfig",
    "draw_noise",
    "masked_mean",
]
