"""The tightrope and the policies trained on it."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.experiments.toy.occlusion import OcclusionConfig
from playlearn.experiments.toy.tightrope import TightropeConfig
from playlearn.experiments.toy.tightrope_env import CUE, turn_back, walk


def test_the_expert_makes_no_mistake_and_steps_back_when_it_stumbles() -> None:
    rng = np.random.default_rng(0)
    clean, stumbling = walk(None, 50, 60, rng), walk(None, 50, 60, rng, stumble=0.2)
    assert clean.mistakes == 0
    assert (clean.observed[..., CUE:] == 0).all()  # so no clone of it ever observes being beside the rope
    # A fifth of 60 turns is random, and two in three of those are wrong: 8.
    assert stumbling.mistakes == pytest.approx(8, abs=1)
    beside = (stumbling.observed[..., CUE:] > 0).any(axis=2)
    assert 0.1 < beside.mean() < 0.5


def test_from_beside_the_rope_the_expert_turns_back() -> None:
    assert turn_back(np.array([0, 1, -1]), np.array([0, 0, 0])).tolist() == [0, 1, -1]
    assert turn_back(np.array([0, 1, -1]), np.array([2, 2, 2])).tolist() == [-1, 0, -1]


@pytest.mark.slow
def test_cloning_compounds_and_dagger_does_not(tmp_path: Path) -> None:
    """Exponents of a small run: nearer to theory's 2 for cloning, to its 1 for the others."""
    config = TightropeConfig(lengths=(10, 20, 40, 80), walks=600, rounds=2, seeds=1)
    rows = config.measure(lambda _: None)
    exponents = {row["method"]: row["exponent"] for row in rows}
    assert exponents.pop("cloning") > 1.6
    assert len(exponents) == 3
    assert max(exponents.values()) < 1.4
    config.plot(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").exists()


@pytest.mark.slow
def test_a_cue_of_two_steps_ago_needs_three_observations(tmp_path: Path) -> None:
    config = OcclusionConfig(histories=(2, 3), labeled=1500, updates=250, walks=50, seeds=1)
    rows = config.measure(lambda _: None)
    rate = {(row["history"], row["occluded"]): row["mistakes_a_step"] for row in rows}
    assert rate[2, True] > 0.5  # random turns: two in three
    assert max(rate[2, False], rate[3, False], rate[3, True]) < 0.1
    config.plot(rows, tmp_path / "plot.png")
