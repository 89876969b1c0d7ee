"""Small, honest experiments: each shows one thing about imitation in minutes on a CPU."""

from playlearn.lab.base import Experiment, load_experiment, run
from playlearn.lab.copying import CopyingConfig
from playlearn.lab.fork import ForkConfig
from playlearn.lab.modes import ModesConfig
from playlearn.lab.occlusion import OcclusionConfig
from playlearn.lab.tightrope import TightropeConfig

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
