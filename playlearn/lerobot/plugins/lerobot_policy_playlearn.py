"""LeRobot imports every installed distribution named `lerobot_policy_*`; this one registers our policies.

It is put beside the package when the wheel is built, with an `egg-info` of that name (see pyproject.toml).
"""

from playlearn.lerobot.configuration_playlearn import PlaylearnConfig

__all__ = ["PlaylearnConfig"]
