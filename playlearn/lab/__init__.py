"""Small, honest experiments: each shows one thing about imitation in minutes on a CPU."""

from playlearn.lab.base import Experiment, load_experiment, run
from playlearn.lab.fork import ForkConfig
from playlearn.lab.modes import ModesConfig

__all__ = ["Experiment", "ForkConfig", "ModesConfig", "load_experiment", "run"]
