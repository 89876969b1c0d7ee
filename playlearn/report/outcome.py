"""Outcome of a training run, as numbers for a program and as text for a person."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Self

from playlearn.report.progress import format_seconds

LOSS = "val/loss"


@dataclass(frozen=True)
class Outcome:
    """Updates, time and validation loss of a training run; losses are of the averaged weights, None without validation.

    steps: updates that were made.
    of_steps: updates that the config asks for.
    seconds: that the updates took.
    val_loss_first: before the first update, or the first one that was measured.
    first_at: its update.
    val_loss_last: after the last update.
    val_loss_least: the lowest.
    least_at: its update.
    """

    steps: int
    of_steps: int
    seconds: float
    val_loss_first: float | None = None
    first_at: int | None = None
    val_loss_last: float | None = None
    val_loss_least: float | None = None
    least_at: int | None = None

    @classmethod
    def of(cls, metrics: Iterable[Mapping[str, float]], steps: int, of_steps: int, seconds: float) -> Self:
        """From the lines of metrics.jsonl."""
        seen = [(int(line["step"]), line[LOSS]) for line in metrics if LOSS in line]
        made = round(seconds, 2)
        if not seen:
            return cls(steps, of_steps, made)
        least_at, least = min(seen, key=lambda at: (math.isnan(at[1]), at[1]))
        return cls(steps, of_steps, made, seen[0][1], seen[0][0], seen[-1][1], least, least_at)

    def numbers(self) -> dict[str, float | None]:
        """For run.json; a loss that is not finite is null there."""
        return {name: None if _not_finite(value) else value for name, value in asdict(self).items()}

    def summary(self) -> list[str]:
        """How far the training came, and the first, last and lowest validation loss."""
        lines = []
        if self.steps < self.of_steps:
            lines.append(
                f"the time limit was reached after {self.steps} of {self.of_steps} updates "
                f"({format_seconds(self.seconds)}): the result will be worse than after all of them; "
                "raise max_minutes, or leave it out"
            )
        if self.val_loss_first is not None:
            began = "before the first update" if self.first_at == 0 else f"at update {self.first_at}"
            lines.append(
                f"held-out loss: {self.val_loss_first:.4g} {began}, {self.val_loss_last:.4g} after "
                f"{self.steps} updates; the least was {self.val_loss_least:.4g} {_at(self.least_at)}"
            )
            if self._risen():
                lines.append("too many updates for so little play, or a learning rate that is too high")
        return lines

    def _risen(self) -> bool:
        """Whether the validation loss fell and rose again; with a likelihood that need not mean a bad policy."""
        first, last, least = self.val_loss_first, self.val_loss_last, self.val_loss_least
        if first is None or last is None or least is None or self.first_at != 0:
            return False
        return least < first <= last < math.inf

    def complaint(self) -> str | None:
        """Why nothing may have been learned; None if the validation loss fell, or its start is not known."""
        first, last, least = self.val_loss_first, self.val_loss_last, self.val_loss_least
        if first is None or last is None or least is None or self.first_at != 0 or last < first or self._risen():
            return None
        if not math.isfinite(last):
            why = "the learning rate is too high, or the play has values that are not finite"
        else:
            why = "too few updates, a learning rate that is too low or too high, or play that shows nothing to learn"
        return (
            f"nothing was learned: the held-out loss is {last:.4g} after {self.steps} of {self.of_steps} updates and "
            f"was {first:.4g} before the first. The likely reason: {why}"
        )


def _at(step: int | None) -> str:
    return "before the first update" if step == 0 else f"at update {step}"


def _not_finite(value: float | None) -> bool:
    return value is not None and not math.isfinite(value)
