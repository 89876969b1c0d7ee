"""Who drives: skills, unstructured play, and the expert that can be asked for an action in any state."""

from playlearn.sim.environment import Environment
from playlearn.teleop.driver import driver_for, register_driver
from playlearn.teleop.expert import Expert
from playlearn.teleop.player import PlayConfig, Player


def expert_for(environment: Environment) -> Expert:
    """The scripted expert of this kind of environment."""
    return Expert(driver_for(environment))


def player_for(environment: Environment, config: PlayConfig) -> Player:
    """The scripted player of this kind of environment."""
    return Player(driver_for(environment), config)


__all__ = ["Expert", "PlayConfig", "Player", "expert_for", "player_for", "register_driver"]
