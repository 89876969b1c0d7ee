"""Any later moment within a horizon, each equally likely."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, later, pick, positive
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("uniform")
@dataclass(frozen=True)
class UniformConfig(GoalSamplerConfig):
    """horizon: seconds that the goal lies ahead at most; less where the episode ends before."""

    horizon: float = 5.0

    def build(self) -> GoalSampler:
        positive("uniform.horizon", self.horizon)
        return Uniform(self.horizon)


@GoalSamplerConfig.register_subclass("future")
@dataclass(frozen=True)
class FutureConfig(GoalSamplerConfig):
    """Any later moment of the episode, however far: HER's strategy "future" (Andrychowicz et al., 2017)."""

    def build(self) -> GoalSampler:
        return Uniform(horizon=1e9)


class Uniform:
    """See `UniformConfig`."""

    def __init__(self, horizon: float) -> None:
        self._horizon = horizon

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return later(table, episodes, t)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        furthest = np.minimum(t + max(1, round(self._horizon * table.fps)), table.lengths[episodes])
        return pick(uniforms[:, 0], t + 1, furthest)
