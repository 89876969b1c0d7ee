"""The diagnostic of copying tells copying from looking."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.experiments.toy.base import Rows
from playlearn.experiments.toy.copying import CopyingConfig, _Examples, _judge

SAMPLE = Path(__file__).resolve().parents[3] / "datasets" / "sample"


def _made(count: int, seed: int) -> _Examples:
    """Two actions: one is the last one again, one is told by what is seen and by nothing before it."""
    rng = np.random.default_rng(seed)
    past = rng.normal(size=(count, 2, 2)).astype(np.float32)
    seen = rng.normal(size=(count, 3)).astype(np.float32)
    return _Examples(past, seen, np.stack([past[:, -1, 0], seen[:, 1]], axis=1))


def test_each_input_is_worth_the_half_that_it_tells() -> None:
    """Of two actions of equal spread one half is in the past and one in what is seen: R2 of 0.5, 0.5 and 1.

    To repeat the last action answers the first half, and is off by twice the spread squared in the other:
    1 - (0 + 2) / 2 = 0.
    """
    known, asked = _made(4000, 0), _made(1000, 1)
    config = CopyingConfig(updates=400, hidden=64, lr=3e-3)

    def worth(past: int, observed: bool) -> float:
        return _judge(config._answers(known, asked, past, observed, 0), known, asked)["r2"]

    assert abs(worth(1, False) - 0.5) < 0.06
    assert abs(worth(0, True) - 0.5) < 0.06
    assert worth(2, True) > 0.95
    assert abs(_judge(asked.past[:, -1], known, asked)["r2"]) < 0.15


@pytest.mark.slow
def test_on_the_sample_of_play_there_is_a_row_for_each_input(tmp_path: Path) -> None:
    """To do the last thing again is worst where the action turns: that is what a turn is."""
    tried = CopyingConfig(store=SAMPLE, past=(1, 2), examples=2000, hidden=32, updates=150, seeds=1)
    rows: Rows = tried.measure(lambda _: None)
    assert [(row["past"], row["observed"]) for row in rows] == [
        *((0, False), (1, False), (2, False)),
        *((0, True), (1, True), (2, True)),
    ]
    assert rows[0]["mean_error_at_turns"] > 2 * rows[0]["mean_error"]
    tried.plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
