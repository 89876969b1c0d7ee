"""Later moments, the nearer the more likely: the discounted future."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, later, positive
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("geometric")
@dataclass(frozen=True)
class GeometricConfig(GoalSamplerConfig):
    """mean: of how many seconds ahead the goal would lie in an endless episode."""

    mean: float = 3.0

    def build(self) -> GoalSampler:
        positive("geometric.mean", self.mean)
        return Geometric(self.mean)


class Geometric:
    """P(g = t + k) is proportional to (1 - p)^(k - 1) for 1 <= k <= T - t, with p = 1 / (mean * fps).

    The goals of contrastive RL (Eysenbach et al., 2022), cut at the end of the episode.
    """

    def __init__(self, mean: float) -> None:
        self._mean = mean

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return later(table, episodes, t)

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        steps = self._mean * table.fps
        if steps <= 1:
            return t + 1
        decay = np.log1p(-1 / steps)  # log(1 - p)
        left = table.lengths[episodes] - t
        # The inverse of the distribution function 1 - (1-p)^k, over 1 - (1-p)^left.
        k = np.ceil(np.log1p(uniforms[:, 0] * np.expm1(decay * left)) / decay).astype(np.int64)
        goals: Indices = t + np.clip(k, 1, left)
        return goals
