"""Progress of a long job and the time left: a bar on a terminal, a plain line now and then on a pipe."""

import math
import statistics
import sys
import time
from bisect import bisect_right
from collections import deque
from typing import Self

from tqdm import tqdm

SOON, EVERY = 5.0, 15.0  # seconds until the first line on a pipe, and between two of them
_RECENT = 100  # measurements in the mean
_OUTLIER = 10  # times the median: longer measurements count as this much


class Pace:
    """Seconds that a unit of work takes: a mean of the last measurements, without the first `warmup`, outliers clipped.

    The first ones include compiling, importing and building; they count as long as there are no others. Outliers (the
    machine slept, a disk hung) say nothing about later units.
    """

    def __init__(self, warmup: int = 0) -> None:
        self._cold: deque[float] = deque(maxlen=max(warmup, 1))
        self._warm: deque[float] = deque(maxlen=_RECENT)
        self._left = warmup

    def add(self, seconds: float) -> None:
        (self._cold if self._left > 0 else self._warm).append(seconds)
        self._left -= 1

    def seconds(self) -> float:
        """NaN while nothing is known."""
        known = self._warm or self._cold
        if not known:
            return math.nan
        ordered = sorted(known)
        most = _OUTLIER * statistics.median(ordered)
        usual = ordered[: bisect_right(ordered, most)]
        return (sum(usual) + most * (len(ordered) - len(usual))) / len(ordered)


class Progress:
    """Counts towards `total` in `unit`s; a context manager.

    name: of the job.
    total: units of work.
    unit: name of a unit.
    begun: units that an earlier, interrupted run had done.
    workers: processes that work in parallel.
    """

    def __init__(self, name: str, total: float, unit: str, begun: float = 0.0, workers: int = 1) -> None:
        self._name, self._total, self._unit, self._workers = name, total, unit, max(workers, 1)
        self._done = begun
        self._started = time.monotonic()
        self._next = self._started + SOON
        self._worked = Pace(warmup=self._workers)  # of a unit; each worker's first piece includes what it builds once
        self._begun = (self._started, begun)
        self._marks: deque[tuple[float, float]] = deque(maxlen=_RECENT)  # (time, done)
        counted = "{percentage:3.0f} %" if unit == "%" else "{n_fmt} of {total_fmt} " + unit + "s"
        self._bar = tqdm(
            total=total,
            initial=begun,
            unit=unit,
            desc=name,
            disable=not sys.stderr.isatty(),
            bar_format="{desc}: " + counted + " |{bar}| {elapsed}{postfix}",
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def to(self, done: float, note: str = "", *, seconds: float | None = None, left: float | None = None) -> None:
        """Show that `done` of `total` is done.

        note: shown beside it.
        seconds: that a worker took for the piece that is now done.
        left: seconds until the end, if the caller knows better.
        """
        now, before = time.monotonic(), self._done
        self._done = min(done, self._total)
        if self._done > before:
            self._marks.append((now, self._done))
            if seconds is not None:
                self._worked.add(seconds / (self._done - before))
        finished = self._done >= self._total
        shown = f"{note + ', ' if note else ''}{self._time(now, finished, left)}"
        if not self._bar.disable:
            self._bar.set_postfix_str(shown, refresh=False)
            self._bar.update(self._done - self._bar.n)
        elif now >= self._next or finished:
            self._next = now + EVERY
            self.say(f"{self._name}: {self._done_text()}, {shown}")

    def say(self, line: str) -> None:
        """A line of its own, above the bar."""
        if self._bar.disable:
            print(line, file=sys.stderr, flush=True)
        else:
            self._bar.write(line, file=sys.stderr)

    def _done_text(self) -> str:
        return f"{self._done:.0f} %" if self._unit == "%" else f"{self._done:.0f} of {self._total:.0f} {self._unit}s"

    def _time(self, now: float, finished: bool, left: float | None) -> str:
        if finished:
            return f"took {format_seconds(now - self._started)}"
        left = self._left() if left is None else left
        return "time left not known yet" if math.isnan(left) else f"about {format_seconds(left)} left"

    def _left(self) -> float:
        rest, worked = self._total - self._done, self._worked.seconds()
        if not math.isnan(worked):
            return rest * worked / self._workers
        if not self._marks:
            return math.nan
        # By the clock, from the first piece on, without the start-up.
        (since, had), (last, has) = self._begun if len(self._marks) == 1 else self._marks[0], self._marks[-1]
        return rest * (last - since) / (has - had)


def format_seconds(seconds: float) -> str:
    """In minutes above two of them, else in seconds."""
    return f"{seconds / 60:.0f} min" if seconds > 120 else f"{seconds:.0f} s"
