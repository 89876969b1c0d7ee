"""Which later moment becomes the goal: index arithmetic only, one file a strategy."""

from playlearn.relabeling.base import UNIFORMS, GoalSampler, GoalSamplerConfig
from playlearn.relabeling.counter_rng import counter_uniforms
from playlearn.relabeling.episode import EpisodeConfig
from playlearn.relabeling.failures import leads_to_failure
from playlearn.relabeling.final import FinalConfig
from playlearn.relabeling.final_settled import FinalSettledConfig
from playlearn.relabeling.fixed import FixedConfig
from playlearn.relabeling.geometric import GeometricConfig
from playlearn.relabeling.hand import events_ahead, grasps
from playlearn.relabeling.images import ImagesConfig
from playlearn.relabeling.index import RelabelIndex, robot_reader
from playlearn.relabeling.mixture import MixtureConfig, WeightedSampler
from playlearn.relabeling.random import RandomConfig
from playlearn.relabeling.robot import RobotConfig
from playlearn.relabeling.settled import SettledConfig
from playlearn.relabeling.settling import SettlingConfig
from playlearn.relabeling.uniform import FutureConfig, UniformConfig

__all__ = [
    "UNIFORMS",
    "EpisodeConfig",
    "FinalConfig",
    "FinalSettledConfig",
    "FixedConfig",
    "FutureConfig",
    "GeometricConfig",
    "GoalSampler",
    "GoalSamplerConfig",
    "ImagesConfig",
    "MixtureConfig",
    "RandomConfig",
    "RelabelIndex",
    "RobotConfig",
    "SettledConfig",
    "SettlingConfig",
    "UniformConfig",
    "WeightedSampler",
    "counter_uniforms",
    "events_ahead",
    "grasps",
    "leads_to_failure",
    "robot_reader",
]
