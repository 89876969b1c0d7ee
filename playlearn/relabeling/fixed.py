"""Always the same time ahead: the window of learning from play."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, positive
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("fixed")
@dataclass(frozen=True)
class FixedConfig(GoalSamplerConfig):
    """seconds: how far ahead the goal lies; steps too near the end of their episode are no examples."""

    seconds: float = 2.0

    def build(self) -> GoalSampler:
        positive("fixed.seconds", self.seconds)
        return Fixed(self.seconds)


class Fixed:
    """See `FixedConfig`; windows of 1 to 2 s in learning from play (Lynch et al., 2019)."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return t + self._steps(table) <= table.lengths[episodes]

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        return t + self._steps(table)

    def _steps(self, table: RelabelIndex) -> int:
        return max(1, round(self._seconds * table.fps))
