"""Which encoder's estimates are learned from, and at how many moments."""

from dataclasses import dataclass
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class PerceivedConfig:
    """Play as an image encoder perceives it.

    encoder: a run whose image encoder estimates where objects are, in observations and goal images.
    every: steps between two moments that are estimated; the errors there are applied to the moments around them.
    folder: where the estimates are kept, for several runs to use; null for the run's own.
    """

    encoder: Path
    every: int = 8
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.every < 1:
            raise UsageError(f"perceived.every must be at least 1, got {self.every}")
