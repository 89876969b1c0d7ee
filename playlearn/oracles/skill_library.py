"""What an environment's file says of acting in it: what play may try there, and which skill serves a goal."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.oracles.end_effector import EndEffector
from playlearn.oracles.skills import Skill
from playlearn.sim.environment import Environment


@dataclass(frozen=True)
class SkillOption:
    """Something that play may try.

    name: the annotation that is recorded.
    kind: its name in `PlayConfig.weights`.
    possible: (achieved) -> bool.
    skill: (hand, achieved, rng) -> the skill, with a goal drawn at random; None where there is no room for it.
    weight: how often it is tried beside the others, where the config does not say.
    """

    name: str
    kind: str
    possible: Callable[[Array], bool]
    skill: Callable[[EndEffector, Array, np.random.Generator], Skill | None]
    weight: float = 1.0


class SkillLibrary(Protocol):
    """The skills of one kind of environment. Its decisions depend on its arguments alone: it is Markov.

    idle: the box ((3,), (3,)) m in which the empty gripper wanders; None where it does not.
    """

    @property
    def idle(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None: ...

    def options(self) -> Sequence[SkillOption]: ...

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        """Whether the gripper holds something that it could drop."""
        ...

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        """A skill that puts down somewhere what the gripper holds."""
        ...

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        """The skill that now leads from `achieved` (G,) towards `goal` (G,)."""
        ...


_SKILL_LIBRARIES: dict[str, Callable[[Environment], SkillLibrary]] = {}


def register_skill_library(kind: str, make: Callable[[Environment], SkillLibrary]) -> None:
    """Register the skill library of environments whose config has this `type`."""
    _SKILL_LIBRARIES[kind] = make


def skill_library_for(environment: Environment) -> SkillLibrary:
    """Raises UsageError where this kind of environment has no skill library."""
    config = environment.config
    kind = str(config.get_choice_name(type(config)))
    if kind not in _SKILL_LIBRARIES:
        raise UsageError(f"{kind!r} has no skill library; {', '.join(sorted(_SKILL_LIBRARIES))} have one")
    return _SKILL_LIBRARIES[kind](environment)


def pick(
    options: Sequence[SkillOption], weights: Mapping[str, float], achieved: Array, rng: np.random.Generator
) -> SkillOption | None:
    """One of the options that are possible now, or None. weights: of kinds; a kind not named keeps its own."""
    weighted = [(option, weights.get(option.kind, option.weight)) for option in options if option.possible(achieved)]
    weighted = [(option, weight) for option, weight in weighted if weight > 0]
    if not weighted:
        return None
    p = np.array([weight for _, weight in weighted])
    return weighted[int(rng.choice(len(weighted), p=p / p.sum()))][0]
