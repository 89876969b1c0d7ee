"""Any moment of any episode: a goal that was most likely not reached from here."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, pick
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("random")
@dataclass(frozen=True)
class RandomConfig(GoalSamplerConfig):
    """The goal is any observation of the split: HER's strategy "random".

    These actions most likely do not lead there: it is a negative, for value or contrastive learning.
    """

    def build(self) -> GoalSampler:
        return Random()


class Random:
    """See `RandomConfig`."""

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return np.ones(len(t), np.bool_)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        first = np.zeros(len(t), np.int64)
        row = pick(uniforms[:, 0], first, first + table.rows[-1] - 1)
        anywhere: Indices = row - table.rows[episodes]
        return anywhere
