"""Whose estimates are learned from, and how often they are made."""

from dataclasses import dataclass
from pathlib import Path

from playlearn.errors import UsageError


@dataclass(frozen=True)
class PerceivedConfig:
    """encoder: a run whose image encoder tells where things are, now and in a goal image.

    every: steps between two moments at which it looks; what it gets wrong there counts for the moments around. folder:
    where that is kept, for several runs to share; null for the run's own.
    """

    encoder: Path
    every: int = 8
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.every < 1:
            raise UsageError(f"perceived.every must be at least 1, got {self.every}")
