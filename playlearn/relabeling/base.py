"""What every strategy of relabeling offers: index arithmetic, and nothing else."""

from dataclasses import dataclass
from typing import Protocol

import draccus
import numpy as np
from numpy.typing import NDArray

from playlearn.errors import UsageError
from playlearn.relabeling.index import Indices, RelabelIndex

UNIFORMS = 2  # random numbers that one goal may use


class GoalSampler(Protocol):
    """Which moment, a later one of its own episode as a rule, becomes the goal of step t. Pure and vectorized."""

    def valid(self, table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
        """(n,) whether a goal can be drawn for step t of each episode, 0 <= t < T."""
        ...

    def draw(self, table: RelabelIndex, episodes: Indices, t: Indices, uniforms: NDArray[np.float64]) -> Indices:
        """(n,) goal observations g for valid steps, counted from the episode's first; t < g <= T as a rule.

        A strategy that draws negatives may also return past observations, or ones of other episodes (g < 0, g > T), by
        the table's flat numbering: the goal is row `table.rows[episode] + g`.

        uniforms: (n, UNIFORMS) independent numbers in [0, 1), the only randomness: an example's goal depends on its own
        numbers alone and never on the batch it is in.
        """
        ...


@dataclass(frozen=True)
class GoalSamplerConfig(draccus.ChoiceRegistry):
    """The base of every sampler's config; `type:` in a YAML picks the kind."""

    @property
    def reads_moments(self) -> bool:
        """Whether a goal depends on the settled moments."""
        return False

    def build(self) -> GoalSampler:
        raise NotImplementedError


def later(table: RelabelIndex, episodes: Indices, t: Indices) -> NDArray[np.bool_]:
    """(n,) whether any observation of the episode is later than t."""
    return t < table.lengths[episodes]


def pick(uniforms: NDArray[np.float64], first: Indices, last: Indices) -> Indices:
    """(n,) whole numbers drawn evenly from first ... last, both included."""
    count = last - first + 1
    # u < 1, but u * count may round up to count for a u just below 1.
    drawn: Indices = first + np.minimum((uniforms * count).astype(np.int64), count - 1)
    return drawn


def positive(name: str, value: float) -> None:
    """Raises UsageError where a setting is not above 0."""
    if not value > 0:
        raise UsageError(f"{name} must be above 0, got {value}")
