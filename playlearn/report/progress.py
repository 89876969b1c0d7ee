"""How far a long job is: a bar on a terminal, a plain line now and then on a pipe."""

import math
import sys
import time
from typing import Self

from tqdm import tqdm

EVERY = 15.0  # seconds between two lines on a pipe


class Progress:
    """Counts towards `total` in `unit`s; a context manager. begun: what an earlier, interrupted run had done."""

    def __init__(self, name: str, total: float, unit: str, begun: float = 0.0) -> None:
        self._name, self._total, self._unit = name, total, unit
        self._begun = self._done = begun
        self._started = self._said = time.monotonic()
        percent = unit == "%"
        form = "{desc}: {percentage:3.0f} %|{bar}| {elapsed} < {remaining} {postfix}" if percent else None
        self._bar = tqdm(
            total=total, initial=begun, unit=unit, desc=name, disable=not sys.stderr.isatty(), bar_format=form
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def to(self, done: float, note: str = "") -> None:
        """`done` of `total` is done; `note` is shown beside it."""
        self._done = min(done, self._total)
        if not self._bar.disable:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(self._done - self._bar.n)
            return
        now = time.monotonic()
        if now - self._said >= EVERY or self._done >= self._total:
            self._said = now
            self.say(f"{self._name}: {self._share()}, {note + ', ' if note else ''}{self._left(now):.0f} s left")

    def say(self, line: str) -> None:
        """A line of its own, above the bar."""
        if self._bar.disable:
            print(line, file=sys.stderr, flush=True)
        else:
            self._bar.write(line, file=sys.stderr)

    def _share(self) -> str:
        return f"{self._done:.0f} %" if self._unit == "%" else f"{self._done:.0f} of {self._total:.0f} {self._unit}s"

    def _left(self, now: float) -> float:
        made = self._done - self._begun
        return (now - self._started) / made * (self._total - self._done) if made > 0 else math.nan
