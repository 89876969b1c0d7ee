"""Small experiments: each shows one property of imitation learning, in minutes on a CPU."""

from playlearn.experiments.toy.base import Experiment, load_experiment, run
from playlearn.experiments.toy.copying import CopyingConfig
from playlearn.experiments.toy.fork import ForkConfig
from playlearn.experiments.toy.modes import ModesConfig
from playlearn.experiments.toy.occlusion import OcclusionConfig
from playlearn.experiments.toy.tightrope import TightropeConfig

__all__ = [
    "CopyingConfig",
    "Experiment",
    "ForkConfig",
    "ModesConfig",
    "OcclusionConfig",
    "TightropeConfig",
    "load_experiment",
    "run",
]
