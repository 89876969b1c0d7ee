"""Thresholds of change and rest, measured on the play itself: how far objects move and how still they lie."""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.quantity import FINEST, continuous, difference, kind, pools, subset

MOVE_SECONDS = 2.0  # within which an object that is being moved gets about as far as it will
QUIET = 0.05  # the fraction of windows, the quietest, that show noise alone: an arm at play seldom rests
FINEST_SHARE = 1e-4  # of its size, where nobody declares the unit: likewise
SWITCHED = 0.5  # of what is 0 or 1
CHANGE_OF_MOVE, REST_OF_MOVE = 1 / 7, 1 / 25
CHANGE_OF_NOISE, REST_OF_NOISE = 7.0, 3.5


def measure(
    rows: Sequence[Array], declared: Sequence[str], fps: float, window: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(G,) change and (G,) rest, read from rows (T+1, G) of play.

    declared: (G,) what each dimension measures, "" where nobody said; those that compare share their thresholds.

    What is 0 or 1 has changed once it is nearer to the other. Of everything else two sizes are measured for each
    quantity. The noise is the range within which it stays in the quietest of twenty windows of `window` steps. A
    typical move is the mean distance covered in 2 s, each distance weighted by itself, so that neither noise nor long
    rests count. A dimension has changed after a seventh of a move and rests within 1/25 of one; or after 7 and within
    3.5 times the noise, where that is more. The thresholds of a dimension that never moves are infinite.

    A two-class split of the ranges (Otsu, 1979) was tried first. An object at rest in a simulator does not move in the
    last digit, so the split fell at 10 micrometers, between two kinds of rest.
    """
    change, rest = np.full(len(declared), np.inf), np.full(len(declared), np.inf)
    if not len(declared) or not len(rows):
        return change, rest
    rows = [continuous(np.asarray(one, np.float64), declared) for one in rows]
    sizes = np.max([np.abs(one).max(axis=0) for one in rows], axis=0)
    finest = np.where([bool(text) for text in declared], FINEST, FINEST_SHARE * sizes)
    moves = np.max([np.ptp(one, axis=0) for one in rows], axis=0) > finest
    lag = max(1, round(MOVE_SECONDS * fps))
    for dimensions in pools(declared):
        own = [k for k in dimensions if moves[k]]
        if own and kind(declared[own[0]]) == "binary":
            change[own], rest[own] = SWITCHED, SWITCHED
        elif own:
            noise, move = _noise_and_move([one[:, own] for one in rows], subset(declared, own), window, lag)
            change[own] = max(CHANGE_OF_MOVE * move, CHANGE_OF_NOISE * noise, finest[own[0]])
            rest[own] = max(REST_OF_MOVE * move, REST_OF_NOISE * noise, finest[own[0]])
    return change, rest


def ranges(rows: Array, window: int) -> Array:
    """(T+1-window, G) within what each dimension of (T+1, G) stayed over each `window` steps."""
    recent = sliding_window_view(rows, window + 1, axis=0)  # (T+1-window, G, window+1)
    spread: Array = recent.max(axis=2) - recent.min(axis=2)
    return spread


def _noise_and_move(rows: Sequence[Array], declared: Sequence[str], window: int, lag: int) -> tuple[float, float]:
    quiet = np.concatenate([ranges(one, min(window, len(one) - 1)).ravel() for one in rows])
    lags = [min(lag, len(one) - 1) for one in rows]
    moved = np.concatenate(
        [np.abs(difference(one[k:], one[:-k], declared)).ravel() for one, k in zip(rows, lags, strict=True)]
    )
    return float(np.quantile(quiet, QUIET)), float(np.square(moved).sum() / max(moved.sum(), np.finfo(float).tiny))
