"""Who drives: skills, unstructured play, and the expert that can be asked for an action in any state."""

from collections.abc import Mapping

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.sim.environment import Environment
from playlearn.teleop.playtable_expert import PlayTableExpert
from playlearn.teleop.playtable_player import PlayConfig, PlayTablePlayer

_EXPERTS = {"playtable": PlayTableExpert}
_PLAYERS = {"playtable": PlayTablePlayer}


def expert_for(environment: Environment) -> PlayTableExpert:
    """The scripted expert of this kind of environment."""
    return _EXPERTS[_kind(environment, _EXPERTS)]()


def player_for(environment: Environment, config: PlayConfig) -> PlayTablePlayer:
    """The scripted player of this kind of environment."""
    return _PLAYERS[_kind(environment, _PLAYERS)](config)


def _kind(environment: Environment, known: Mapping[str, type]) -> str:
    config = environment.config
    kind = config.get_choice_name(type(config))
    if kind not in known:
        raise UsageError(f"nobody can drive {kind!r} yet; there are teleoperators for {', '.join(known)}")
    return str(kind)


__all__ = ["Array", "PlayConfig", "PlayTableExpert", "PlayTablePlayer", "expert_for", "player_for"]
