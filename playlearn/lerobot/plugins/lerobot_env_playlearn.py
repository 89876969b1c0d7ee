"""LeRobot imports every installed distribution whose name begins with `lerobot_env_`; this one registers our worlds."""

from playlearn.lerobot.env import PlaylearnEnvConfig

__all__ = ["PlaylearnEnvConfig"]
