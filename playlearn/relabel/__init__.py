"""Which later moment becomes the goal: index arithmetic only, one file a strategy."""

from playlearn.relabel.base import UNIFORMS, GoalSampler, GoalSamplerConfig
from playlearn.relabel.chance import counter_uniforms
from playlearn.relabel.ending import EndingConfig
from playlearn.relabel.episode import EpisodeConfig
from playlearn.relabel.failures import leads_to_failure
from playlearn.relabel.final import FinalConfig
from playlearn.relabel.fixed import FixedConfig
from playlearn.relabel.geometric import GeometricConfig
from playlearn.relabel.mixture import MixtureConfig, Share
from playlearn.relabel.random import RandomConfig
from playlearn.relabel.robot import RobotConfig
from playlearn.relabel.settled import SettledConfig
from playlearn.relabel.settling import SettlingConfig, matching
from playlearn.relabel.table import Table
from playlearn.relabel.uniform import FutureConfig, UniformConfig

__all__ = [
    "UNIFORMS",
    "EndingConfig",
    "EpisodeConfig",
    "FinalConfig",
    "FixedConfig",
    "FutureConfig",
    "GeometricConfig",
    "GoalSampler",
    "GoalSamplerConfig",
    "MixtureConfig",
    "RandomConfig",
    "RobotConfig",
    "SettledConfig",
    "SettlingConfig",
    "Share",
    "Table",
    "UniformConfig",
    "counter_uniforms",
    "leads_to_failure",
    "matching",
]
