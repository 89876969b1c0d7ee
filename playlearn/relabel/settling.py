"""When the world counts as changed and when as at rest: thresholds, given or measured from the play itself."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.errors import UsageError

Thresholds = dict[str, float | None]

MOVE_SECONDS = 2.0  # the time in which a thing that is being moved goes about as far as it will go
QUIET = 0.1  # the share of windows, the quietest, that show nothing but noise
FINEST = 1e-4  # SI units: what never left so small a range has not moved, whatever its last digits do
CHANGE_OF_MOVE, REST_OF_MOVE = 1 / 7, 1 / 25
CHANGE_OF_NOISE, REST_OF_NOISE = 6.0, 3.0


@dataclass(frozen=True)
class SettlingConfig:
    """When the world counts as changed, and when as at rest.

    change: pattern of achieved names -> how far a dimension moves before it has changed (metres; for
        `*.c` and `*.s`, the cosine and sine of an orientation, their own unit; lamps 0 or 1).
    rest: pattern -> within what a dimension stays for the world to be at rest.
    rest_seconds: for how long it must stay there.

    `default` speaks of every name that no pattern matches; of several that match, the last counts. A
    threshold of null is measured from the play (see `measure`): `{default: null}` measures them all.
    """

    change: Thresholds = field(default_factory=lambda: {"default": 0.015, "*.c": 0.15, "*.s": 0.15, "lamp*": 0.5})
    rest: Thresholds = field(default_factory=lambda: {"default": 0.004, "*.c": 0.05, "*.s": 0.05, "lamp*": 0.5})
    rest_seconds: float = 0.3

    def window(self, fps: float) -> int:
        """rest_seconds in steps."""
        return max(1, round(self.rest_seconds * fps))

    def measured(self, rows: Iterable[Array], names: Sequence[str], fps: float) -> Self:
        """The same with each null replaced by what is measured on rows, each (T+1, G); reads none if there is none."""
        if None not in (*self.change.values(), *self.rest.values()):
            return self
        change, rest = measure(list(rows), names, fps, self.window(fps))
        return replace(
            self, change=_filled(self.change, names, change, "change"), rest=_filled(self.rest, names, rest, "rest")
        )


def thresholds(patterns: Mapping[str, float | None], names: Sequence[str], what: str) -> NDArray[np.float64]:
    """(G,) the threshold of each name.

    Raises:
        UsageError: a name has none, or one is not positive.
    """
    values = []
    for name in names:
        value = _given(patterns, name, what)
        if value is None or not value > 0:
            raise UsageError(f"settling.{what}: {name} needs a threshold above 0, got {value}")
        values.append(value)
    return np.array(values, np.float64)


def matching(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """The indices of the names that match one of the shell-style patterns.

    Raises:
        UsageError: a pattern matches none of them (where there are any).
    """
    for pattern in patterns:
        if names and not any(fnmatchcase(name, pattern) for name in names):
            raise UsageError(f"goal_names: {pattern!r} matches none of: {', '.join(names)}")
    return [k for k, name in enumerate(names) if any(fnmatchcase(name, pattern) for pattern in patterns)]


def measure(
    rows: Sequence[Array], names: Sequence[str], fps: float, window: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(G,) change and (G,) rest, read from rows (T+1, G) of play.

    Dimensions that share a part name (`red.x`, `blue.x`) are of one kind and share their thresholds. Of
    each kind two sizes are read: the noise, within what it stays in the quietest tenth of all windows of
    `window` steps; and a typical move, the mean of how far it gets in 2 s, each weighted by itself, so that
    neither noise nor long rests count. It has changed after a seventh of a move, and rests within 1/25 of
    one; or after 6 and within 3 times the noise, where that is more. What never moves has no threshold
    to pass: infinity.

    A two-class split of the ranges (Otsu, 1979) was tried first. What lies still in a simulator does so to
    the last digit, so the split came to stand at 10 micrometres, between two kinds of standing still.
    """
    change, rest = np.full(len(names), np.inf), np.full(len(names), np.inf)
    if not len(names) or not len(rows):
        return change, rest
    moves = np.max([np.ptp(one, axis=0) for one in rows], axis=0) > FINEST
    parts = np.array([name.rpartition(".")[2] for name in names])
    lag = max(1, round(MOVE_SECONDS * fps))
    for part in dict.fromkeys(parts.tolist()):
        own = (parts == part) & moves
        if own.any():
            noise, move = _noise_and_move([np.asarray(one[:, own], np.float64) for one in rows], window, lag)
            change[own] = max(CHANGE_OF_MOVE * move, CHANGE_OF_NOISE * noise, FINEST)
            rest[own] = max(REST_OF_MOVE * move, REST_OF_NOISE * noise, FINEST)
    return change, rest


def ranges(rows: Array, window: int) -> Array:
    """(T+1-window, G) within what each dimension of (T+1, G) stayed over each `window` steps."""
    recent = sliding_window_view(rows, window + 1, axis=0)  # (T+1-window, G, window+1)
    spread: Array = recent.max(axis=2) - recent.min(axis=2)
    return spread


def _noise_and_move(rows: Sequence[Array], window: int, lag: int) -> tuple[float, float]:
    quiet = np.concatenate([ranges(one, min(window, len(one) - 1)).ravel() for one in rows])
    lags = [min(lag, len(one) - 1) for one in rows]
    moved = np.concatenate([np.abs(one[k:] - one[:-k]).ravel() for one, k in zip(rows, lags, strict=True)])
    return float(np.quantile(quiet, QUIET)), float(np.square(moved).sum() / max(moved.sum(), np.finfo(float).tiny))


def _given(patterns: Mapping[str, float | None], name: str, what: str) -> float | None:
    fitting = [value for pattern, value in patterns.items() if pattern != "default" and fnmatchcase(name, pattern)]
    if not fitting and "default" not in patterns:
        raise UsageError(f"settling.{what}: {name} needs a threshold; add one, or `default`")
    return fitting[-1] if fitting else patterns["default"]


def _filled(patterns: Thresholds, names: Sequence[str], measured: Array, what: str) -> Thresholds:
    """A threshold for each name: the given one, or the measured one where that is null."""
    given = [_given(patterns, name, what) for name in names]
    filled = [own if value is None else value for value, own in zip(given, measured.tolist(), strict=True)]
    return dict(zip(names, filled, strict=True))
