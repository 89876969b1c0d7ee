"""When the expert takes over from a policy that has drifted, and when it hands back."""

from dataclasses import dataclass
from typing import Protocol

import draccus

from playlearn.errors import UsageError


@dataclass(frozen=True)
class Drift:
    """How it stands at one step of one environment.

    distance: largest difference, over the action's dimensions, between what the policy would do and what the expert
    would. spread: see `PolicyActor.spread`; of the policy's last plan.
    """

    distance: float
    spread: float = 0.0


class Gate(Protocol):
    """Of one environment; asked once a step, in order."""

    def __call__(self, drift: Drift) -> bool:
        """Whether the expert acts now."""
        ...


@dataclass(frozen=True)
class GateConfig(draccus.ChoiceRegistry):
    """The base of every gate's config; `type:` in a YAML picks the kind."""

    @property
    def sampled(self) -> int:
        """How many chunks it asks of the policy's head at every plan."""
        return 0

    def build(self) -> Gate:
        """A gate for one episode, closed."""
        raise NotImplementedError


@GateConfig.register_subclass("none")
@dataclass(frozen=True)
class NoGateConfig(GateConfig):
    """The expert takes over only where beta says so."""

    def build(self) -> Gate:
        return lambda _drift: False


@dataclass(frozen=True)
class LatchConfig(GateConfig):
    """What gates have in common.

    above: opens once its measure was above this for `steps` steps running. below: closes once it was at most this
    (null: `above`) for `agreeing` steps running, or after `most` steps open (null: only then).
    """

    above: float = 0.5
    steps: int = 4
    below: float | None = None
    agreeing: int = 8
    most: int | None = None

    def __post_init__(self) -> None:
        for name in ("above", "steps", "agreeing"):
            if getattr(self, name) <= 0:
                raise UsageError(f"gate.{name} must be above 0, got {getattr(self, name):g}")
        if self.below is not None and not 0 <= self.below <= self.above:
            raise UsageError(f"gate.below must lie between 0 and gate.above ({self.above:g}), got {self.below:g}")
        if self.most is not None and self.most < 1:
            raise UsageError(f"gate.most must be 1 or more, or null, got {self.most}")

    def measure(self, drift: Drift) -> float:
        raise NotImplementedError

    def build(self) -> Gate:
        return Latch(self)


class Latch:
    """See `LatchConfig`."""

    def __init__(self, config: LatchConfig) -> None:
        self._config = config
        self._open = False
        self._running = 0  # steps in a row that speak for the other state
        self._since = 0

    def __call__(self, drift: Drift) -> bool:
        config, value = self._config, self._config.measure(drift)
        if self._open:
            below = config.above if config.below is None else config.below
            self._running = self._running + 1 if value <= below else 0
            over = config.most is not None and self._since >= config.most
            self._turn(over or self._running >= config.agreeing)
        else:
            self._running = self._running + 1 if value > config.above else 0
            self._turn(self._running >= config.steps)
        self._since += 1
        return self._open

    def _turn(self, now: bool) -> None:
        if now:
            self._open, self._running, self._since = not self._open, 0, 0


@GateConfig.register_subclass("distance")
@dataclass(frozen=True)
class DistanceConfig(LatchConfig):
    """The policy's action is far from the expert's: what a person who watches sees (HG-DAgger, Kelly et al., 2019)."""

    def measure(self, drift: Drift) -> float:
        return drift.distance


@GateConfig.register_subclass("uncertainty")
@dataclass(frozen=True)
class UncertaintyConfig(LatchConfig):
    """The policy's own samples disagree: needs no expert to notice it. samples: chunks that are compared."""

    above: float = 0.15
    samples: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples < 2:
            raise UsageError(f"gate.samples must be 2 or more, got {self.samples}")

    @property
    def sampled(self) -> int:
        return self.samples

    def measure(self, drift: Drift) -> float:
        return drift.spread
