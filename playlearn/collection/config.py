"""The config of a collection, and which of its fields decide the episodes."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from playlearn.config import to_dict
from playlearn.envs import PlayTableConfig
from playlearn.errors import UsageError
from playlearn.oracles import PlayConfig, PlayPolicyConfig
from playlearn.sim import EnvironmentConfig

_FREE = ("episodes", "timeout")  # do not change what is in an episode


@dataclass(frozen=True)
class CollectConfig:
    """A collection of play.

    environment: where to play.
    play: the play policy.
    episodes: how many.
    steps: control steps of an episode at most.
    cameras: which of the environment's cameras to record; none is fastest, and `playlearn render` renders them later
        from the simulator states, which are always recorded.
    seed: with an episode's number it decides everything in that episode.
    timeout: seconds after which a worker that still plays the same episode counts as hung and is replaced (null: see
        `limit`; .inf: never).
    """

    environment: EnvironmentConfig = field(default_factory=PlayTableConfig)
    play: PlayPolicyConfig = field(default_factory=PlayConfig)
    episodes: int = 100
    steps: int = 400
    cameras: tuple[str, ...] = ()
    seed: int = 0
    timeout: float | None = None

    def __post_init__(self) -> None:
        for name in ("episodes", "steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.timeout is not None and not self.timeout > 0:
            raise UsageError(f"timeout must be more than 0 s, got {self.timeout:g} (null: from steps; .inf: never)")

    def limit(self) -> float | None:
        """Seconds an episode may take; by default far above what the slowest machine and renderer need."""
        if self.timeout is None:
            return 300.0 + self.steps * (0.5 + 0.5 * len(self.cameras))
        return self.timeout if math.isfinite(self.timeout) else None

    def settings(self) -> dict[str, Any]:
        """What decides the episodes, as JSON."""
        return {key: value for key, value in to_dict(self).items() if key not in _FREE}


def episode_seed(seed: int, index: int) -> int:
    """The seed of episode `index` of a collection."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
