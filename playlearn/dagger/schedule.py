"""beta: the fraction of stretches in which the expert acts, round by round."""

from dataclasses import dataclass

import draccus

from playlearn.errors import UsageError


@dataclass(frozen=True)
class BetaConfig(draccus.ChoiceRegistry):
    """The base of every schedule; `type:` in a YAML picks the kind."""

    def at(self, number: int) -> float:
        """The probability, in round 1, 2, ..., that a stretch is the expert's."""
        raise NotImplementedError


@BetaConfig.register_subclass("zero")
@dataclass(frozen=True)
class ZeroConfig(BetaConfig):
    """Only the policy acts, from the first round on."""

    def at(self, number: int) -> float:
        return 0.0


@BetaConfig.register_subclass("constant")
@dataclass(frozen=True)
class ConstantConfig(BetaConfig):
    """The same in every round.

    value: the probability.
    """

    value: float = 0.2

    def __post_init__(self) -> None:
        _check_probability("constant.value", self.value)

    def at(self, number: int) -> float:
        return self.value


@BetaConfig.register_subclass("linear")
@dataclass(frozen=True)
class LinearConfig(BetaConfig):
    """Linear decay.

    start: the probability in round 1.
    rounds: after so many it is 0.
    """

    start: float = 1.0
    rounds: int = 5

    def __post_init__(self) -> None:
        _check_probability("linear.start", self.start)
        if self.rounds < 1:
            raise UsageError(f"beta: linear.rounds must be 1 or more, got {self.rounds}")

    def at(self, number: int) -> float:
        return self.start * max(0.0, 1 - (number - 1) / self.rounds)


@BetaConfig.register_subclass("exponential")
@dataclass(frozen=True)
class ExponentialConfig(BetaConfig):
    """Exponential decay: p^(i-1) in Ross et al. (2011).

    start: the probability in round 1.
    base: factor from one round to the next.
    """

    start: float = 1.0
    base: float = 0.5

    def __post_init__(self) -> None:
        _check_probability("exponential.start", self.start)
        _check_probability("exponential.base", self.base)

    def at(self, number: int) -> float:
        return float(self.start * self.base ** (number - 1))


def _check_probability(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise UsageError(f"beta: {name} is a probability between 0 and 1, got {value:g}")
