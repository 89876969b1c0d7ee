"""Precision and recall of settled moments, on moments that are known."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.bench import Size
from playlearn.bench.settled import agreement, settling
from playlearn.cli import main
from playlearn.relabeling import RelabelIndex, SettlingConfig
from tests.relabeling.test_robot import FPS


def index(names: tuple[str, ...], *moved: tuple[int, int, float]) -> RelabelIndex:
    """One episode of 200 steps in which each (observation, dimension, value) is set from there on."""
    achieved = np.zeros((201, len(names)), np.float32)
    for t, dimension, value in moved:
        achieved[t:, dimension] = value
    declared = tuple("binary on" if name.startswith("led") else "length x" for name in names)
    return RelabelIndex.build([achieved], names, FPS, SettlingConfig(), declared)


def test_moments_agree_within_half_a_second_and_each_shows_one_configuration() -> None:
    """True ones are at 47, 107 and 147, 0.3 s after each move; found ones at 52, 77, 100 and 187.

    By moments 52 and 100 are right, and 47 and 107 found. By configurations 52 shows the first, 77 nothing that it had
    not shown, 100 the second (within half a second of its begin) and 187, late, the third: the lamp's, small.
    """
    true = index(("red.x", "led.on"), (40, 0, 0.1), (100, 0, 0.2), (140, 1, 1.0))
    found = index(("red.x", "led.on"), (45, 0, 0.1), (70, 0, 0.2), (93, 0, 0.3), (180, 0, 0.4))
    assert true.moments.tolist() == [46, 106, 146]
    agreed = agreement(true, found)
    assert agreed.near.tolist() == [True, False, True, False]
    assert agreed.found.tolist() == [True, True, False]
    assert agreed.shows.tolist() == [True, False, True, True]
    assert agreed.shown.tolist() == [True, True, True]
    assert agreed.small.tolist() == [False, False, True]
    assert agreed.missed == []
    assert agreed.false == [(0, int(found.moments[1]))]


def test_the_sample_is_measured_and_its_misses_are_drawn(tmp_path: Path) -> None:
    size = Size(store=Path("datasets/sample"), cameras=("front",), picture=tmp_path / "misses.png")
    figures = {figure.name: figure for figure in settling(size)}
    for source in ("robot", "images"):
        assert 0 <= figures[f"{source}: precision by configurations"].value <= 100
        assert figures[f"{source}: moments"].unit.startswith("of ")


def test_what_is_missing_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "settled"]) == 2
    assert "name the play to measure on, --store STORE" in capsys.readouterr().err
    assert main(["bench", "settled", "--store", "datasets/sample", "--cameras", "top"]) == 2
    assert "not top" in capsys.readouterr().err
