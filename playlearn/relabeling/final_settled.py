"""How the episode ended: any moment of the configuration that lasts until its end."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, later, pick
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("final_settled")
@dataclass(frozen=True)
class FinalSettledConfig(GoalSamplerConfig):
    """The goal is drawn from the last settled configuration, where that lasts until the end; else it is the last
    observation. Any of its observations may be drawn, so that what the arm does in a goal image does not matter.

    For episodes that end on purpose, as DAgger's do.
    """

    @property
    def reads_moments(self) -> bool:
        return True

    def build(self) -> GoalSampler:
        return FinalSettled()


class FinalSettled:
    """See `FinalSettledConfig`."""

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return later(table, episodes, t)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        end, last = table.lengths[episodes], table.offsets[episodes + 1] - 1
        first = end
        if len(table.moments):
            lasts = (last >= table.offsets[episodes]) & (table.ends[last] == end)
            first = np.where(lasts, np.maximum(table.moments[last], t + 1), end)
        return pick(uniforms[:, 0], first, end)
