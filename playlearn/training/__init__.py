"""Learn a policy from a store of play."""

from playlearn.training.config import TrainConfig
from playlearn.training.job import train

__all__ = ["TrainConfig", "train"]
