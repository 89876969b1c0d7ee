"""beta: how much of the acting the expert does, round by round."""

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
    """The policy alone acts, from the first round on."""

    def at(self, number: int) -> float:
        return 0.0


@BetaConfig.register_subclass("constant")
@dataclass(frozen=True)
class ConstantConfig(BetaConfig):
    """value: in every round."""

    value: float = 0.2

    def __post_init__(self) -> None:
        _share("constant.value", self.value)

    def at(self, number: int) -> float:
        return self.value


@BetaConfig.register_subclass("linear")
@dataclass(frozen=True)
class LinearConfig(BetaConfig):
    """From `start` in round 1 down to 0 after `rounds` rounds."""

    start: float = 1.0
    rounds: int = 5

    def __post_init__(self) -> None:
        _share("linear.start", self.start)
        if self.rounds < 1:
            raise UsageError(f"beta: linear.rounds must be 1 or more, got {self.rounds}")

    def at(self, number: int) -> float:
        return self.start * max(0.0, 1 - (number - 1) / self.rounds)


@BetaConfig.register_subclass("exponential")
@dataclass(frozen=True)
class ExponentialConfig(BetaConfig):
    """`start` in round 1, and `base` times the last round's in every other: p^(i-1) in Ross et al. (2011)."""

    start: float = 1.0
    base: float = 0.5

    def __post_init__(self) -> None:
        _share("exponential.start", self.start)
        _share("exponential.base", self.base)

    def at(self, number: int) -> float:
        return float(self.start * self.base ** (number - 1))


def _share(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise UsageError(f"beta: {name} is a probability between 0 and 1, got {value:g}")
