"""Who drives: skills, unstructured play, and the expert that can be asked for an action in any state."""

from playlearn.sim.environment import Actor, Environment
from playlearn.teleop.driver import driver_for, register_driver
from playlearn.teleop.expert import Expert, Teacher, register_expert, special_expert
from playlearn.teleop.player import PlayConfig, Player, PlayerConfig


def expert_for(environment: Environment) -> Teacher:
    """The scripted expert of this kind of environment."""
    return special_expert(environment) or Expert(driver_for(environment))


def player_for(environment: Environment, config: PlayerConfig) -> Actor:
    """Who plays as `config` says, in this environment."""
    return config.build(environment)


__all__ = [
    "Expert",
    "PlayConfig",
    "Player",
    "PlayerConfig",
    "Teacher",
    "expert_for",
    "player_for",
    "register_driver",
    "register_expert",
]
