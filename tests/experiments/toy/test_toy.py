"""Laws of the toy experiments' data and scores."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from playlearn.cli import main
from playlearn.experiments.toy import load_experiment
from playlearn.experiments.toy.base import TrainingConfig
from playlearn.experiments.toy.fork import ForkConfig, _check, _ways
from playlearn.experiments.toy.modes import ModesConfig, _centers, _examples, _score
from playlearn.policies.heads import GaussianConfig, MixtureConfig

CONFIGS = sorted((Path(__file__).resolve().parents[3] / "configs" / "toy").glob("*.yaml"))
QUICK = TrainingConfig(updates=150, batch=64)


def test_the_demonstrations_of_the_fork_are_valid_and_go_both_ways() -> None:
    fork = ForkConfig(left=0.25)
    disc, chunks = fork._examples(2000, torch.Generator().manual_seed(0))
    valid, side = _check(_ways(chunks.numpy()), disc.numpy())
    assert valid.mean() > 0.99
    assert abs((side > 0).mean() - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 2000)


def test_straight_ahead_hits_the_disc_and_standing_still_does_not_arrive() -> None:
    straight = np.tile(np.array([1 / 16, 0.0]), (1, 16, 1))
    for chunks in (straight, np.zeros((1, 16, 2))):
        assert not _check(_ways(chunks), np.zeros((1, 1)))[0].any()


@pytest.mark.parametrize(("dimensions", "modes"), [(2, 8), (7, 4), (14, 8)])
def test_examples_of_many_modes_score_as_near_and_even(dimensions: int, modes: int) -> None:
    centers = _centers(dimensions, modes)
    _, chunks = _examples(centers)(4000, torch.Generator().manual_seed(0))
    valid, coverage = _score(chunks, centers)
    assert valid > 0.99
    assert coverage > 0.98
    assert _score(centers[:1].expand(50, -1, -1), centers) == (1.0, pytest.approx(1 / modes))
    assert _score(torch.zeros(5, *centers.shape[1:]), centers) == (0.0, 0.0)


@pytest.mark.slow
def test_a_mixture_goes_round_the_disc_and_one_gaussian_goes_into_it(tmp_path: Path) -> None:
    fork = ForkConfig(
        heads={"one": GaussianConfig(hidden=32), "two": MixtureConfig(components=4, hidden=32, std_range=(0.02, 2.0))},
        training=TrainingConfig(updates=300, batch=64),
        samples=200,
    )
    one, two = fork.measure(lambda _: None)
    assert one["mode_valid"] == 0.0
    assert two["valid"] > 0.8
    assert two["coverage"] > 0.5
    fork.plot([one, two], tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_modes_has_a_row_a_cell(tmp_path: Path) -> None:
    config = ModesConfig(
        heads={"one": GaussianConfig(hidden=16)}, training=QUICK, samples=50, dimensions=(2, 7), modes=(2,)
    )
    rows = config.measure(lambda _: None)
    assert [(row["dimensions"], row["modes"]) for row in rows] == [(2, 2), (7, 2)]
    config.plot(rows, tmp_path / "plot.png")


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_config_describes_an_experiment(path: Path) -> None:
    assert type(load_experiment(path, [])).__name__.removesuffix("Config").lower() == path.stem


def test_the_command_writes_results_and_a_plot_and_overwrites_neither(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = tmp_path / "fork.yaml", tmp_path / "out"
    config.write_text("experiment: {type: fork, heads: {one: {type: gaussian, hidden: 8}}, samples: 20}")
    command = ["toy", "--config", str(config), "--out", str(out), "--training.updates", "5"]
    assert main(command) == 0
    assert json.loads((out / "results.json").read_text())["rows"][0]["head"] == "one"
    assert (out / "plot.png").exists()
    assert main(command) == 2
    assert "another --out" in capsys.readouterr().err
