"""Any other moment of the same episode, past ones included."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, pick
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("episode")
@dataclass(frozen=True)
class EpisodeConfig(GoalSamplerConfig):
    """The goal is any other observation of the episode: HER's strategy "episode" (Andrychowicz et al., 2017)."""

    def build(self) -> GoalSampler:
        return AnyOfEpisode()


class AnyOfEpisode:
    """See `EpisodeConfig`."""

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return np.ones(len(t), np.bool_)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        other = pick(uniforms[:, 0], np.zeros(len(t), np.int64), table.lengths[episodes] - 1)
        return other + (other >= t)  # all but t itself
