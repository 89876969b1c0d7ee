"""Which scenes are rendered, how many, and how often training shows them."""

from dataclasses import dataclass
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class ScenesConfig:
    """Scenes that the simulator renders from a store's recorded states, with the true state: privileged information.

    per_episode: scenes of each episode, at random moments.
    rearranged: fraction of them whose objects are placed anew, as a random start of the environment places them. The
        robot stays as recorded; scenes of held-out episodes are never rearranged.
    fraction: of the training examples, how many are scenes; at 1 the store needs no images of its own.
    seed: of the moments and the rearrangements.
    folder: where they are kept, for several runs to use; null for the run's own.
    """

    per_episode: int = 120
    rearranged: float = 0.5
    fraction: float = 1.0
    seed: int = 0
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.per_episode < 1:
            raise UsageError(f"scenes.per_episode must be at least 1, got {self.per_episode}")
        if not 0 <= self.rearranged <= 1:
            raise UsageError(f"scenes.rearranged is a fraction, 0 to 1, got {self.rearranged}")
        if not 0 < self.fraction <= 1:
            raise UsageError(f"scenes.fraction must lie above 0 and at most at 1, got {self.fraction}")
