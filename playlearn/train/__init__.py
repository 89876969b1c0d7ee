"""Learn a policy from a store of play."""

from playlearn.train.config import TrainConfig
from playlearn.train.job import train

__all__ = ["TrainConfig", "train"]
