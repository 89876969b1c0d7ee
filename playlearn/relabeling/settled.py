"""The default: one of the next moments at which the achieved goal has changed and come to rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from playlearn.errors import UsageError
from playlearn.relabeling.base import GoalSampler, GoalSamplerConfig, pick, positive
from playlearn.relabeling.index import Indices, RelabelIndex


@GoalSamplerConfig.register_subclass("settled")
@dataclass(frozen=True)
class SettledConfig(GoalSamplerConfig):
    """The goal is one of the next settled configurations.

    ahead: how many of them may be drawn, each equally likely.
    until_next_change: whether the goal is any observation of the configuration, until it changes, so that what the arm
        does in a goal image does not matter; False: the settled moment itself.
    settle_slack: seconds past a settled moment in which its own configuration still is the next one (what to do once
        there: let go, draw back); 0 moves on at the settled moment.
    """

    ahead: int = 1
    until_next_change: bool = True
    settle_slack: float = 0.0

    @property
    def reads_moments(self) -> bool:
        return True

    def build(self) -> GoalSampler:
        positive("settled.ahead", self.ahead)
        if self.settle_slack < 0:
            raise UsageError(f"settled.settle_slack must not be below 0, got {self.settle_slack}")
        return Settled(self.ahead, self.until_next_change, self.settle_slack)


class Settled:
    """See `SettledConfig`, and the drawing in `index.py`."""

    def __init__(self, ahead: int, until_next_change: bool, settle_slack: float) -> None:
        self._ahead, self._until_next_change, self._slack = ahead, until_next_change, settle_slack

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        return self._next(table, episodes, t) < table.offsets[episodes + 1]

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        following = self._next(table, episodes, t)
        last = np.minimum(following + self._ahead, table.offsets[episodes + 1]) - 1
        chosen = pick(uniforms[:, 0], following, last)
        first = np.maximum(table.moments[chosen], t + 1)  # only slack lets t be past the settled moment
        return pick(uniforms[:, 1], first, table.ends[chosen]) if self._until_next_change else first

    def _next(self, table: RelabelIndex, episodes: Indices, t: Indices) -> Indices:
        following = table.following(episodes, t)
        slack = round(self._slack * table.fps)
        if slack == 0 or len(table.moments) == 0:
            return following
        current = np.maximum(following - 1, 0)  # the configuration that t stands in, where it has one
        own = following > table.offsets[episodes]
        stays = own & (t <= table.moments[current] + slack) & (t < table.ends[current])
        return np.where(stays, current, following)
