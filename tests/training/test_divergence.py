"""A run stops at the first number that is not finite, says why, and what was saved before stays whole."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from playlearn import cli
from playlearn.config import save_config
from playlearn.data import PlayDataset
from playlearn.errors import CheckpointError, StoreError, TrainingDiverged
from playlearn.policies import Policy
from playlearn.store import NativeStore, open_store
from playlearn.training import TrainConfig, train
from playlearn.training import job as module
from tests.synthetic import make_store
from tests.training.test_train import config, metrics

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("diverging") / "play"
    make_store(path, np.random.default_rng(0), episodes=4, steps=100)
    return path


def saved(run: Path) -> dict[str, str]:
    """What the checkpoint and the policy hold."""
    files = sorted(path for folder in ("checkpoint", "policy") for path in (run / folder).glob("*"))
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def throw(monkeypatch: pytest.MonkeyPatch, step: int, value: float) -> None:
    """Set every weight to a number at the end of that update."""
    plain = module._Run.update

    def update(run: Any, batch: Any) -> Any:
        made = plain(run, batch)
        if run.step == step - 1:
            with torch.no_grad():
                for parameter in (*run.policy.parameters(), *run.ema.parameters()):
                    parameter.fill_(value)
        return made

    monkeypatch.setattr(module._Run, "update", update)


@pytest.fixture
def three_steps(play: Path, tmp_path: Path) -> tuple[Path, dict[str, str]]:
    """A run of three updates and what it saved."""
    train(config(play, steps=3), tmp_path / "run")
    return tmp_path / "run", saved(tmp_path / "run")


def longer(play: Path, **more: Any) -> TrainConfig:
    return dataclasses.replace(config(play), **{"steps": 20, "val_every": 20, "checkpoint_every": 20, **more})


def test_it_stops_at_the_first_loss_that_is_not_finite(
    play: Path, three_steps: tuple[Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights of 1e30 after step 5: their products overflow in step 6, whatever the data."""
    run, before = three_steps
    throw(monkeypatch, 5, 1e30)
    with pytest.raises(
        TrainingDiverged, match=r"step 6: its loss is .*its data are finite.*lower lr \(0.0005\).*stay those of step 3$"
    ):
        train(longer(play), run, resume=True)
    assert saved(run) == before
    assert Policy.load(run / "policy").config.chunk == 4


@pytest.mark.parametrize("every", ["checkpoint_every", "val_every"])
def test_what_is_not_finite_is_never_saved(
    every: str, play: Path, three_steps: tuple[Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A weight that the very update before a checkpoint, or before held-out play, has made infinite."""
    run, before = three_steps
    throw(monkeypatch, 5, torch.inf)
    with pytest.raises(TrainingDiverged, match=r"step 5: its (weight encoder\..* is not finite|held-out loss is nan)"):
        train(longer(play, **{every: 5}), run, resume=True)
    assert saved(run) == before
    assert metrics(run)[-1]["step"] < 5


def test_a_batch_that_is_not_finite_is_named(play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = PlayDataset.batch

    def batch(data: Any, epoch: Any, indices: Any) -> Any:
        made = plain(data, epoch, indices)
        if data.config.val_fraction:
            made.goal_achieved[3, 1] = torch.nan
        return made

    monkeypatch.setattr(PlayDataset, "batch", batch)
    named = r"data are to blame: goal_achieved red.y is nan in example 3 of the batch; nothing was saved yet"
    for step, settings in ((0, config(play)), (1, config(play, val_batches=0))):
        with pytest.raises(TrainingDiverged, match=f"step {step}: .*{named}"):
            train(settings, tmp_path / f"run{step}")
        assert saved(tmp_path / f"run{step}") == {}


@pytest.mark.parametrize(
    ("key", "value", "name"),
    [
        ("observation.state", np.nan, "eef.y"),
        ("achieved", np.inf, "red.y"),
        ("action", -np.inf, "dy"),
        ("expert_action", np.nan, "dy"),
    ],
)
def test_a_number_of_the_store_that_is_not_finite_is_named_before_training(
    key: str, value: float, name: str, play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = NativeStore.array

    def array(store: NativeStore, i: int, asked: str) -> Any:
        values = plain(store, i, asked)
        if (i, asked) == (2, key):
            values = values.copy()
            values[17, 1] = value
        return values

    monkeypatch.setattr(NativeStore, "array", array)
    with pytest.raises(StoreError, match=rf"play, episode 2, {key}: {name} is {value} in row 17"):
        train(config(play), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(StoreError, match="row 17"):
        config(play).data.build(open_store(play), "train", 0)


def test_the_command_ends_with_exit_code_1(
    play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_config(config(play), tmp_path / "train.yaml")
    throw(monkeypatch, 1, 1e30)
    assert cli.main(["train", "--config", str(tmp_path / "train.yaml"), "--out", str(tmp_path / "run")]) == 1
    assert "training diverged at step 2: its loss is" in capsys.readouterr().err


def test_nothing_begins_from_weights_that_are_not_finite(play: Path, three_steps: tuple[Path, dict[str, str]]) -> None:
    """As runs left them that went on with NaN: neither acting nor going on begins from them."""
    run, _ = three_steps
    for file, prefix in ((run / "policy" / "policy.safetensors", ""), (run / "checkpoint/last.safetensors", "policy.")):
        with safe_open(file, "pt") as opened:
            note = opened.metadata()
        tensors = load_file(file)
        tensors[f"{prefix}encoder.goal_flag"][0] = torch.nan
        save_file(tensors, file, note)
    with pytest.raises(CheckpointError, match=r"policy is of a run that diverged \(.* is not finite\): it cannot act"):
        Policy.load(run / "policy")
    with pytest.raises(CheckpointError, match=r"last.safetensors is of a run that diverged \(policy\..* is not finite"):
        train(longer(play), run, resume=True)
