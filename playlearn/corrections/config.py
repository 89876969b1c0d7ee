"""How many moments are displaced, how far, and how often training shows them."""

from dataclasses import dataclass
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class CorrectionsConfig:
    """Displaced moments of play.

    fraction: of the training examples, how many are corrected ones.
    displacement: of the end effector, meters at most.
    turn: of the end effector, radians at most.
    per_episode: displaced moments of each episode, fewer where the end effector is rarely free.
    steps: within how many the corrected labels lead back.
    seed: of the moments and displacements.
    folder: where they are kept, for several runs to use; null for the run's own.
    """

    fraction: float = 0.2
    displacement: float = 0.03
    turn: float = 0.2
    per_episode: int = 20
    steps: int = 8
    seed: int = 0
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if not 0 < self.fraction <= 1:
            raise UsageError(f"corrections.fraction must lie above 0 and at most at 1, got {self.fraction}")
        for name in ("displacement", "turn"):
            if getattr(self, name) < 0:
                raise UsageError(f"corrections.{name} must not be below 0, got {getattr(self, name)}")
        for name in ("per_episode", "steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"corrections.{name} must be at least 1, got {getattr(self, name)}")
