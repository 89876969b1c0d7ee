"""The end of the episode."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, later
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("final")
@dataclass(frozen=True)
class FinalConfig(GoalSamplerConfig):
    """The goal is the last observation: HER's strategy "final" (Andrychowicz et al., 2017)."""

    def build(self) -> GoalSampler:
        return Final()


class Final:
    """See `FinalConfig`."""

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return later(table, episodes, t)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        return table.lengths[episodes]
