"""The diagnostic of copying distinguishes copying from observing."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.experiments.toy.base import Rows
from playlearn.experiments.toy.copying import CopyingConfig, _Examples, _score

SAMPLE = Path(__file__).resolve().parents[3] / "datasets" / "sample"


def _made(count: int, seed: int) -> _Examples:
    """Two actions: one repeats the last one, one is in the observation and in nothing before it."""
    rng = np.random.default_rng(seed)
    past = rng.normal(size=(count, 2, 2)).astype(np.float32)
    observation = rng.normal(size=(count, 3)).astype(np.float32)
    return _Examples(past, observation, np.stack([past[:, -1, 0], observation[:, 1]], axis=1))


@pytest.mark.slow
def test_each_input_predicts_its_half_of_the_action() -> None:
    """Of two actions of equal std one is in the past and one in the observation: R2 of 0.5, 0.5 and 1.

    Repeating the last action predicts the first, and is off by twice the variance in the other: 1 - (0 + 2) / 2 = 0.
    """
    train, val = _made(4000, 0), _made(1000, 1)
    config = CopyingConfig(updates=400, hidden=64, lr=3e-3)

    def r2(past: int, observed: bool) -> float:
        return _score(config._predict(train, val, past, observed, 0), train, val)["r2"]

    assert abs(r2(1, False) - 0.5) < 0.06
    assert abs(r2(0, True) - 0.5) < 0.06
    assert r2(2, True) > 0.95
    assert abs(_score(val.past[:, -1], train, val)["r2"]) < 0.15


@pytest.mark.slow
def test_on_the_sample_of_play_there_is_a_row_for_each_input(tmp_path: Path) -> None:
    """Repeating the last action is worst where the action turns: that is what a turn is."""
    config = CopyingConfig(store=SAMPLE, past=(1, 2), examples=2000, hidden=32, updates=150, seeds=1)
    rows: Rows = config.measure(lambda _: None)
    assert [(row["past"], row["observed"]) for row in rows] == [
        *((0, False), (1, False), (2, False)),
        *((0, True), (1, True), (2, True)),
    ]
    assert rows[0]["mean_error_at_turns"] > 2 * rows[0]["mean_error"]
    config.plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
