"""Which later moment becomes the goal: index arithmetic only, one file a strategy."""

from playlearn.relabel.base import UNIFORMS, GoalSampler, GoalSamplerConfig
from playlearn.relabel.final import FinalConfig
from playlearn.relabel.fixed import FixedConfig
from playlearn.relabel.geometric import GeometricConfig
from playlearn.relabel.mixture import MixtureConfig, Share
from playlearn.relabel.settled import SettledConfig
from playlearn.relabel.table import SettlingConfig, Table
from playlearn.relabel.uniform import UniformConfig

__all__ = [
    "UNIFORMS",
    "FinalConfig",
    "FixedConfig",
    "GeometricConfig",
    "GoalSampler",
    "GoalSamplerConfig",
    "MixtureConfig",
    "SettledConfig",
    "SettlingConfig",
    "Share",
    "Table",
    "UniformConfig",
]
