"""PlayTable: a table with blocks and fixtures, made for play."""

from playlearn.tasks.playtable.driver import PlayTableDriver
from playlearn.tasks.playtable.world import PlayTableConfig, PlayTableWorld
from playlearn.teleop import register_driver

register_driver("playtable", lambda _: PlayTableDriver())

__all__ = ["PlayTableConfig", "PlayTableWorld"]
