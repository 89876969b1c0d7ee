"""PlayTable: a table with blocks and fixtures, made for play."""

from playlearn.envs.playtable.env import PlayTableConfig, PlayTableEnv
from playlearn.envs.playtable.skill_library import PlayTableSkillLibrary
from playlearn.oracles import register_skill_library

register_skill_library("playtable", lambda _: PlayTableSkillLibrary())

__all__ = ["PlayTableConfig", "PlayTableEnv"]
