"""Scripted actors: skills, unstructured play, and the expert that can be asked for an action in any state."""

from playlearn.oracles.expert import Expert, ExpertPolicy, register_expert, special_expert
from playlearn.oracles.play_policy import PlayConfig, PlayPolicy, PlayPolicyConfig
from playlearn.oracles.skill_library import register_skill_library, skill_library_for
from playlearn.sim.environment import Actor, Environment


def expert_for(environment: Environment) -> ExpertPolicy:
    """The scripted expert of this kind of environment."""
    return special_expert(environment) or Expert(skill_library_for(environment))


def play_policy_for(environment: Environment, config: PlayPolicyConfig) -> Actor:
    """The play policy that `config` describes, in this environment."""
    return config.build(environment)


__all__ = [
    "Expert",
    "ExpertPolicy",
    "PlayConfig",
    "PlayPolicy",
    "PlayPolicyConfig",
    "expert_for",
    "play_policy_for",
    "register_expert",
    "register_skill_library",
]
