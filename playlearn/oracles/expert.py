"""The expert: asked for an action in any state, it does what its skill library does there."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.oracles.end_effector import EndEffector, Style
from playlearn.oracles.skill_library import SkillLibrary
from playlearn.sim.environment import Actor, Environment


class ExpertPolicy(Actor, Protocol):
    """An actor that can be asked in any state; its only memory is its goals."""

    def decide(self, seen: Observation, goal: Array) -> Decision:
        """What to do in this state towards goal (G,)."""
        ...


_EXPERTS: dict[str, Callable[[Environment], ExpertPolicy]] = {}


def register_expert(kind: str, make: Callable[[Environment], ExpertPolicy]) -> None:
    """Register the expert of environments that have no `SkillLibrary`, by the `type` of their config."""
    _EXPERTS[kind] = make


def special_expert(environment: Environment) -> ExpertPolicy | None:
    """The one registered for this kind of environment."""
    config = environment.config
    make = _EXPERTS.get(str(config.get_choice_name(type(config))))
    return None if make is None else make(environment)


class Expert:
    """An Actor whose only memory is its goals; the reference row of every evaluation."""

    name = "expert"
    cameras: tuple[str, ...] = ()

    def __init__(self, skill_library: SkillLibrary, style: Style | None = None) -> None:
        self._skill_library = skill_library
        self._style = style or Style()
        self._goals: list[Array] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._goals = [np.zeros(0) if goal is None else goal.achieved for goal in goals]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        return [self.decide(seen, goal) for seen, goal in zip(observations, self._goals, strict=True)]

    def decide(self, seen: Observation, goal: Array) -> Decision:
        """What to do in this state towards goal (G,)."""
        hand = EndEffector.seen(seen)
        skill = self._skill_library.towards(hand, seen.achieved, goal)
        return Decision(skill.act(hand, seen.achieved, self._style), skill=skill.name)
