"""What a task's file says about driving it: what play may try there, and which skill serves a goal."""

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
    """Something that play may try. kind: what `PlayConfig.weights` calls it.

    weight: how often it is tried beside the others, where the config does not say. possible: (achieved) -> bool.
    skill: (hand, achieved, rng) -> how it is brought about, with a goal drawn at random; None where there turns
    out to be no room for it.
    """

    name: str
    kind: str
    possible: Callable[[Array], bool]
    skill: Callable[[EndEffector, Array, np.random.Generator], Skill | None]
    weight: float = 1.0


class SkillLibrary(Protocol):
    """How to drive one kind of environment. Everything it decides follows from what it is given: it is Markov.

    idle: the box ((3,), (3,)) m in which an idle hand wanders, where it does.
    """

    @property
    def idle(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None: ...

    def options(self) -> Sequence[SkillOption]: ...

    def holding(self, hand: EndEffector, achieved: Array) -> bool:
        """Whether the hand has hold of something that it could drop."""
        ...

    def put_down(self, hand: EndEffector, achieved: Array, rng: np.random.Generator) -> Skill:
        """A place for what is in the hand."""
        ...

    def towards(self, hand: EndEffector, achieved: Array, goal: Array) -> Skill:
        """What to do now to bring `achieved` (G,) to `goal` (G,)."""
        ...


_DRIVERS: dict[str, Callable[[Environment], SkillLibrary]] = {}


def register_skill_library(kind: str, make: Callable[[Environment], SkillLibrary]) -> None:
    """Say who drives the environments whose config is registered as `kind`."""
    _DRIVERS[kind] = make


def skill_library_for(environment: Environment) -> SkillLibrary:
    """Raises UsageError where nobody can drive this kind of environment."""
    config = environment.config
    kind = str(config.get_choice_name(type(config)))
    if kind not in _DRIVERS:
        raise UsageError(f"nobody can drive {kind!r} yet; there are drivers for {', '.join(sorted(_DRIVERS))}")
    return _DRIVERS[kind](environment)


def pick(
    options: Sequence[SkillOption], weights: Mapping[str, float], achieved: Array, rng: np.random.Generator
) -> SkillOption | None:
    """One of the ideas that are possible now, or None. weights: of kinds; what it does not name keeps its own."""
    open_to = [(option, weights.get(option.kind, option.weight)) for option in options if option.possible(achieved)]
    open_to = [(option, weight) for option, weight in open_to if weight > 0]
    if not open_to:
        return None
    share = np.array([weight for _, weight in open_to])
    return open_to[int(rng.choice(len(open_to), p=share / share.sum()))][0]
