"""Several strategies, each with its weight."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from playlearn.errors import UsageError
from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, positive
from playlearn.relabeling.index import Indices, RelabelIndex
from playlearn.relabeling.settled import SettledConfig
from playlearn.relabeling.uniform import UniformConfig


@dataclass(frozen=True)
class WeightedSampler:
    """One strategy of a mixture.

    goals: the strategy.
    weight: how often it is used, relative to the others' weights.
    """

    goals: GoalSamplerConfig
    weight: float = 1.0


def _default() -> list[WeightedSampler]:
    return [WeightedSampler(SettledConfig(), 0.8), WeightedSampler(UniformConfig(), 0.2)]


@GoalSamplerConfig.register_subclass("mixture")
@dataclass(frozen=True)
class MixtureConfig(GoalSamplerConfig):
    """samplers: the strategies; where one can draw no goal for a step, the others take over its weight."""

    samplers: list[WeightedSampler] = field(default_factory=_default)

    @property
    def reads_moments(self) -> bool:
        return any(sampler.goals.reads_moments for sampler in self.samplers)

    def build(self) -> GoalSampler:
        if not self.samplers:
            raise UsageError("mixture.samplers is empty: name at least one strategy")
        for sampler in self.samplers:
            positive("mixture.samplers.weight", sampler.weight)
        return Mixture([sampler.goals.build() for sampler in self.samplers], [one.weight for one in self.samplers])


class Mixture:
    """See `MixtureConfig`."""

    def __init__(self, samplers: Sequence[GoalSampler], weights: Sequence[float]) -> None:
        self._samplers, self._weights = tuple(samplers), np.array(weights, np.float64)

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return np.asarray(self._can(table, episodes, t).any(axis=1))

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        weights = self._can(table, episodes, t) * self._weights  # (n, samplers)
        upper = np.cumsum(weights / weights.sum(axis=1, keepdims=True), axis=1)
        upper[:, -1] = 1.0
        chosen = (uniforms[:, :1] >= upper).sum(axis=1)
        chosen = np.where(weights[np.arange(len(t)), chosen] > 0, chosen, weights.argmax(axis=1))
        goals = np.zeros_like(t)
        for number, sampler in enumerate(self._samplers):
            mine = np.flatnonzero(chosen == number)
            low, high = (upper[mine, number - 1] if number else 0.0), upper[mine, number]
            # Within its interval the number that chose the strategy is again uniform over [0, 1).
            inner = uniforms[mine].copy()
            inner[:, 0] = np.clip((inner[:, 0] - low) / (high - low), 0.0, np.nextafter(1.0, 0.0))
            goals[mine] = sampler.draw(table, episodes[mine], t[mine], inner)
        return goals

    def _can(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return np.stack([sampler.valid(table, episodes, t) for sampler in self._samplers], axis=1)
