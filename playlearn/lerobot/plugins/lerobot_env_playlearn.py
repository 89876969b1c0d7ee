"""LeRobot imports every installed distribution named `lerobot_env_*`; this one registers our environments."""

from playlearn.lerobot.env import PlaylearnEnvConfig

__all__ = ["PlaylearnEnvConfig"]
