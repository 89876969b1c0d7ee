"""A robot of somebody else under LeRobot's commands: `--env.discover_packages_path=tests.lerobot.so100_env`."""

from tests.lerobot.so100_env.env import So100Env, So100EnvConfig, play

__all__ = ["So100Env", "So100EnvConfig", "play"]
