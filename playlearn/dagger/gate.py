"""When the expert takes over from a policy that has drifted, and when it hands back."""

from dataclasses import dataclass
from typing import Protocol

import draccus

from playlearn.errors import UsageError


@dataclass(frozen=True)
class GateSignal:
    """What a gate measures at one step of one environment.

    distance: largest difference, over the action's dimensions, between the policy's action and the expert's.
    std: of the policy's last plan; see `PolicyActor.std`.
    """

    distance: float
    std: float = 0.0


class Gate(Protocol):
    """Of one environment; asked once a step, in order."""

    def __call__(self, signal: GateSignal) -> bool:
        """Whether the expert acts now."""
        ...


@dataclass(frozen=True)
class GateConfig(draccus.ChoiceRegistry):
    """The base of every gate's config; `type:` in a YAML picks the kind."""

    @property
    def sampled(self) -> int:
        """How many chunks it samples from the policy's head at every plan."""
        return 0

    def build(self) -> Gate:
        """A gate for one episode, closed."""
        raise NotImplementedError


@GateConfig.register_subclass("none")
@dataclass(frozen=True)
class NoGateConfig(GateConfig):
    """The expert takes over only as beta draws it."""

    def build(self) -> Gate:
        return lambda _signal: False


@dataclass(frozen=True)
class HysteresisGateConfig(GateConfig):
    """What gates have in common.

    open_above: opens once its measure was above this for `steps` steps in a row.
    steps: see `open_above`.
    close_below: closes once its measure was at most this (null: `open_above`) for `close_after` steps in a row.
    close_after: see `close_below`.
    max_steps: closes after so many steps in any case (null: never).
    """

    open_above: float = 0.5
    steps: int = 4
    close_below: float | None = None
    close_after: int = 8
    max_steps: int | None = None

    def __post_init__(self) -> None:
        for name in ("open_above", "steps", "close_after"):
            if getattr(self, name) <= 0:
                raise UsageError(f"gate.{name} must be above 0, got {getattr(self, name):g}")
        if self.close_below is not None and not 0 <= self.close_below <= self.open_above:
            raise UsageError(
                f"gate.close_below must lie between 0 and gate.open_above ({self.open_above:g}), "
                f"got {self.close_below:g}"
            )
        if self.max_steps is not None and self.max_steps < 1:
            raise UsageError(f"gate.max_steps must be 1 or more, or null, got {self.max_steps}")

    def measure(self, signal: GateSignal) -> float:
        raise NotImplementedError

    def build(self) -> Gate:
        return HysteresisGate(self)


class HysteresisGate:
    """See `HysteresisGateConfig`."""

    def __init__(self, config: HysteresisGateConfig) -> None:
        self._config = config
        self._open = False
        self._running = 0  # steps in a row on the other side of the threshold
        self._since = 0

    def __call__(self, signal: GateSignal) -> bool:
        config, value = self._config, self._config.measure(signal)
        if self._open:
            close_below = config.open_above if config.close_below is None else config.close_below
            self._running = self._running + 1 if value <= close_below else 0
            over = config.max_steps is not None and self._since >= config.max_steps
            self._turn(over or self._running >= config.close_after)
        else:
            self._running = self._running + 1 if value > config.open_above else 0
            self._turn(self._running >= config.steps)
        self._since += 1
        return self._open

    def _turn(self, now: bool) -> None:
        if now:
            self._open, self._running, self._since = not self._open, 0, 0


@GateConfig.register_subclass("distance")
@dataclass(frozen=True)
class DistanceConfig(HysteresisGateConfig):
    """The policy's action is far from the expert's: what a person who watches sees (HG-DAgger, Kelly et al., 2019)."""

    def measure(self, signal: GateSignal) -> float:
        return signal.distance


@GateConfig.register_subclass("uncertainty")
@dataclass(frozen=True)
class UncertaintyConfig(HysteresisGateConfig):
    """The policy's own samples disagree: needs no expert to measure it. samples: chunks that are compared."""

    open_above: float = 0.15
    samples: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples < 2:
            raise UsageError(f"gate.samples must be 2 or more, got {self.samples}")

    @property
    def sampled(self) -> int:
        return self.samples

    def measure(self, signal: GateSignal) -> float:
        return signal.std
