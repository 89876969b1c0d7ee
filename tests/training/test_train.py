"""Laws of training: resumption, interruption, what a run leaves, and what it refuses."""

import contextlib
import dataclasses
import importlib.metadata
import json
import math
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from playlearn.config import from_dict, load_config
from playlearn.data import PlayDataset, statistics
from playlearn.errors import CheckpointError, NotLearnedError, StoreError, UsageError
from playlearn.policies import Policy
from playlearn.policies.normalize import scaled
from playlearn.quantity import Quantities
from playlearn.report.progress import Pace
from playlearn.store import NativeStore, StoreSpec
from playlearn.threads import limit
from playlearn.training import TrainConfig, train
from playlearn.training import job as module
from tests.policies.parts import small
from tests.synthetic import make_episode, make_store

torch.set_num_threads(1)
CONFIGS = sorted((Path(__file__).parents[2] / "configs" / "train").glob("*.yaml"))


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("train") / "play"
    make_store(path, np.random.default_rng(0), episodes=4, steps=150, cameras=("front", "wrist"))
    return path


def config(store: Path, encoder: str = "state", head: str = "deterministic", **more: Any) -> TrainConfig:
    fields = {
        "store": str(store),
        "policy": {"encoder": small(encoder), "trunk": small("mlp"), "head": small(head), "chunk": 4},
        "batch_size": 8,
        "steps": 4,
        "warmup": 2,
        "log_every": 2,
        "val_every": 2,
        "val_batches": 1,
        "cpu": True,
    }
    return from_dict(TrainConfig, fields | more)


def stop_after(monkeypatch: pytest.MonkeyPatch, steps: int, how: int) -> None:
    """Send a signal to this process during that update, as a user's Ctrl-C would."""
    plain = module._Run.update

    def update(run: Any, batch: Any) -> Any:
        if run.step == steps - 1:
            os.kill(os.getpid(), how)
        return plain(run, batch)

    monkeypatch.setattr(module._Run, "update", update)


@pytest.mark.parametrize(("encoder", "head"), [("state", "deterministic"), ("cnn", "diffusion")])
def test_a_resumed_run_is_an_unbroken_one_bit_for_bit(
    encoder: str, head: str, play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """4 updates against 2, Ctrl-C, 2 more: all weights, averages, moments and metrics are equal."""
    settings = config(play, encoder, head)
    train(settings, tmp_path / "whole")
    with monkeypatch.context() as patch:
        stop_after(patch, 2, signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            train(settings, tmp_path / "broken")
    half = load_file(tmp_path / "broken" / "checkpoint" / "last.safetensors")
    train(settings, tmp_path / "broken", resume=True)
    whole, broken = (load_file(tmp_path / run / "checkpoint" / "last.safetensors") for run in ("whole", "broken"))
    assert whole.keys() == broken.keys()
    assert [name for name in whole if not torch.equal(whole[name], broken[name])] == []
    assert any(not torch.equal(half[name], broken[name]) for name in half), "two more updates must change something"
    assert any(name.startswith("optimizer.") for name in whole)
    assert metrics(tmp_path / "whole") == metrics(tmp_path / "broken")


def metrics(run: Path) -> list[dict[str, float]]:
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [{name: value for name, value in line.items() if name != "seconds"} for line in lines]


def test_an_interrupted_run_keeps_its_checkpoint_and_gives_the_signal_back(
    play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        stop_after(patch, 3, signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            train(config(play, steps=100), tmp_path / "run")
    assert signal.getsignal(signal.SIGTERM) is before
    Policy.load(tmp_path / "run" / "policy")
    train(config(play, steps=3), tmp_path / "run", resume=True)  # three updates were done: nothing is left to do
    assert metrics(tmp_path / "run")[-1]["step"] == 2


def test_what_a_run_leaves(play: Path, tmp_path: Path) -> None:
    settings = config(play)
    out = tmp_path / "run"
    train(settings, out)
    assert load_config(TrainConfig, out / "config.yaml") == settings.resolved()
    record = json.loads((out / "run.json").read_text())
    assert record["seed"] == 0
    assert record["versions"]["torch"] == importlib.metadata.version("torch")
    assert {"git_revision", "parameters", "store", "environment"} <= record.keys()
    checkpoint = load_file(out / "checkpoint" / "last.safetensors")
    saved = load_file(out / "policy" / "policy.safetensors")
    assert all(torch.equal(value, checkpoint[f"ema.module.{name}"]) for name, value in saved.items())
    assert any(not torch.equal(value, checkpoint[f"policy.{name}"]) for name, value in saved.items())
    steps = [(line["step"], next(name for name in line if "/" in name).partition("/")[0]) for line in metrics(out)]
    assert steps == [(0, "val"), (2, "train"), (2, "val"), (4, "train"), (4, "val")]
    assert not list(out.rglob("*.tmp"))


def test_statistics_come_from_the_training_episodes(play: Path, tmp_path: Path) -> None:
    settings = config(play, steps=1)
    train(settings, tmp_path / "run")
    policy = Policy.load(tmp_path / "run" / "policy")
    data = settings.resolved().data.build(module.open_store(play), "train", 0)
    expected = scaled(statistics(data), policy.spec)
    for name in ("state", "achieved"):
        for what in ("mean", "std"):
            stored = policy.normalizer.get_buffer(f"{name}_{what}")
            torch.testing.assert_close(stored, torch.from_numpy(getattr(expected[name], what)))


def test_play_in_other_units_is_learned_alike(tmp_path: Path) -> None:
    """All numbers times 1e-4, and nobody says what they measure: the same loss and error, in shares of a spread."""
    episodes = [make_episode(np.random.default_rng(seed), 120, seed=seed) for seed in range(3)]
    found = []
    for scale in (1.0, 1e-4):
        units = [
            dataclasses.replace(
                one,
                meta=dataclasses.replace(one.meta, quantities=Quantities()),
                **{
                    name: getattr(one, name) * np.float32(scale)
                    for name in ("state", "achieved", "action", "expert_action")
                },
            )
            for one in episodes
        ]
        store = NativeStore.create(tmp_path / f"{scale}", StoreSpec.of(units[0]))
        with store.writer() as writer:
            for episode in units:
                writer.append(episode)
        with contextlib.suppress(NotLearnedError):  # its actions are noise
            train(config(store.path, steps=4, data={"val_fraction": 0.3}), tmp_path / f"run{scale}")
        found.append([line for line in metrics(tmp_path / f"run{scale}") if "val/loss" in line][-1])
    for name in ("val/loss", "val/action_error"):
        assert found[1][name] == pytest.approx(found[0][name], rel=1e-3)
    assert found[0]["val/action_error"] > 0.3  # of a spread: after 4 updates nothing is learned yet


def test_training_learns(play: Path, tmp_path: Path) -> None:
    """60 updates on play whose actions are noise around zero: the loss at least leaves where it began."""
    train(config(play, steps=60, log_every=5, val_batches=0, lr=3e-3, batch_size=32), tmp_path / "run")
    losses = [line["train/loss"] for line in metrics(tmp_path / "run") if "train/loss" in line]
    assert losses[-1] < losses[0] - 0.005


def test_the_learning_rate_warms_up_and_falls_to_zero(play: Path, tmp_path: Path) -> None:
    """lr (step + 1) / warmup at first, and half a cosine over all 10 steps: at step 5, half of the peak."""
    train(config(play, steps=10, log_every=1, val_every=10, lr=0.01), tmp_path / "run")
    rates = [line["train/lr"] for line in metrics(tmp_path / "run") if "train/lr" in line]
    assert rates[0] == pytest.approx(0.005)
    assert rates[5] == pytest.approx(0.005)
    assert rates[9] == pytest.approx(0.01 * 0.5 * (1 + math.cos(0.9 * math.pi)))


def test_minutes_end_a_run_and_bend_its_schedule(
    play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A clock that gains 3 s at each look lets one minute end after 20 updates of 3 s, long before 1000: it says so."""
    now = iter(range(0, 10**6, 3))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(now)))
    monkeypatch.setattr(module, "Progress", Silent)
    train(config(play, steps=1000, max_minutes=1, log_every=1, val_every=1000), tmp_path / "run")
    lines = [line for line in metrics(tmp_path / "run") if "train/lr" in line]
    assert lines[-1]["step"] in (20, 21)
    last = metrics(tmp_path / "run")[-1]  # the last update is the one that is evaluated and saved
    assert last["step"] == lines[-1]["step"]
    assert "val/loss" in last
    assert Policy.load(tmp_path / "run" / "policy").config.chunk == config(play).policy.chunk
    assert lines[-1]["train/lr"] < 0.05 * lines[2]["train/lr"]
    outcome = json.loads((tmp_path / "run" / "run.json").read_text())["outcome"]
    assert (outcome["steps"], outcome["of_steps"]) == (last["step"], 1000)
    assert f"after {last['step']} of 1000 updates" in capsys.readouterr().err


class Silent:
    def __init__(self, *_: object) -> None: ...
    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...
    def to(self, *_: object, **__: object) -> None: ...
    def say(self, *_: object) -> None: ...


def test_how_it_ended_is_said_and_kept(play: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The loss before the first update, after the last, and the least; a resumed run does not begin anew."""
    out = tmp_path / "run"
    train(config(play, steps=2), out)
    train(config(play, steps=4), out, resume=True)
    losses = {line["step"]: line["val/loss"] for line in metrics(out) if "val/loss" in line}
    assert [line["step"] for line in metrics(out) if "val/loss" in line] == [0, 2, 4]
    outcome = json.loads((out / "run.json").read_text())["outcome"]
    assert outcome["val_loss_first"] == losses[0]
    assert outcome["val_loss_last"] == losses[4]
    assert outcome["val_loss_least"] == losses[outcome["least_at"]] == min(losses.values())
    assert (outcome["steps"], outcome["of_steps"]) == (4, 4)
    assert f"held-out loss: {losses[0]:.4g} before the first update, {losses[4]:.4g} after 4 updates" in (
        capsys.readouterr().err
    )


def test_without_held_out_play_nothing_is_said_of_it_and_training_is_the_same(
    play: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is evaluated, before the first update too, draws on nothing that training draws on."""
    settings = config(play, "state", "diffusion")
    train(settings, tmp_path / "validated")
    capsys.readouterr()
    train(dataclasses.replace(settings, val_batches=0), tmp_path / "plain")
    assert "held-out" not in capsys.readouterr().err
    assert json.loads((tmp_path / "plain" / "run.json").read_text())["outcome"]["val_loss_last"] is None
    validated, plain = (load_file(tmp_path / run / "policy" / "policy.safetensors") for run in ("validated", "plain"))
    assert all(torch.equal(validated[name], plain[name]) for name in validated)


@pytest.mark.slow
def test_a_fresh_policy_that_learned_nothing_is_an_error_and_is_kept(
    play: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rate of 10 throws the weights far away. A run from a trained policy may end where that was, or above."""
    with pytest.raises(NotLearnedError, match=r"nothing was learned.* after 4 of 4 updates .*learning rate"):
        train(config(play, lr=10.0, ema_decay=0.0), tmp_path / "run")
    assert Policy.load(tmp_path / "run" / "policy").config.chunk == 4
    assert json.loads((tmp_path / "run" / "run.json").read_text())["outcome"]["steps"] == 4
    train(config(play), tmp_path / "first")
    train(config(play, lr=10.0, ema_decay=0.0, init_from=str(tmp_path / "first")), tmp_path / "second")
    outcome = json.loads((tmp_path / "second" / "run.json").read_text())["outcome"]
    assert outcome["val_loss_last"] > outcome["val_loss_first"]


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Those in force at each update, in the data's thread too; afterwards it is one again."""
    seen: list[int] = []
    update, batch = module._Run.update, PlayDataset.batch

    def counted(run: Any, batch: Any) -> Any:
        seen.append(torch.get_num_threads())
        return update(run, batch)

    def read(data: Any, *arguments: Any) -> Any:
        if threading.current_thread() is not threading.main_thread():
            seen.append(torch.get_num_threads())
        return batch(data, *arguments)

    monkeypatch.setattr(module._Run, "update", counted)
    monkeypatch.setattr(PlayDataset, "batch", read)
    yield seen
    limit(1)


@pytest.mark.slow
def test_threads_are_chosen_once(play: Path, tmp_path: Path, threads: list[int]) -> None:
    """One by default, whatever torch had; another number is another run."""
    torch.set_num_threads(2)
    train(config(play, steps=2), tmp_path / "one")
    assert set(threads) == {1}
    threads.clear()
    train(config(play, steps=2, threads=2), tmp_path / "two")
    assert set(threads) == {2}
    assert len(threads) >= 4, "two updates, and the batches for them"
    runs = {run: json.loads((tmp_path / run / "run.json").read_text())["threads"] for run in ("one", "two")}
    assert runs == {"one": 1, "two": 2}
    with pytest.raises(UsageError, match="another threads"):
        train(config(play, steps=4), tmp_path / "two", resume=True)


@pytest.mark.slow
def test_a_run_is_resumed_with_the_threads_it_was_begun_with(play: Path, tmp_path: Path, threads: list[int]) -> None:
    """A run from before `threads` was a setting: only run.json has what torch chose."""
    train(config(play, steps=2), tmp_path / "run")
    file = tmp_path / "run" / "run.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "threads": 2}))
    threads.clear()
    train(config(play, steps=4), tmp_path / "run", resume=True)
    assert set(threads) == {2}


@pytest.mark.parametrize(("step", "minutes", "end"), [(0, None, 20), (7, None, 20), (19, None, 20), (6, 1, 16)])
def test_time_left_counts_evaluations_and_checkpoints(step: int, minutes: float | None, end: int, play: Path) -> None:
    """Updates of 3 s, evaluations of 5 s every 4, checkpoints of 7 s every 6; the last update has both. 60 s are 20."""
    settings = config(play, steps=20, max_minutes=minutes, val_every=4, checkpoint_every=6)
    paces = {"update": Pace(), "evaluate": Pace(), "save": Pace()}
    for kind, seconds in (("update", 3.0), ("evaluate", 5.0), ("save", 7.0)):
        paces[kind].add(seconds)
    spent = 30.0 if minutes else 0.0
    run = SimpleNamespace(config=settings, step=step, seconds=spent, paces=paces)
    ahead = range(step + 1, end + 1)
    evaluations = sum(number % 4 == 0 or number == end for number in ahead)
    checkpoints = sum(number % 6 == 0 or number == end for number in ahead)
    assert module._Run.left(run) == pytest.approx(3 * len(ahead) + 5 * evaluations + 7 * checkpoints)


def test_a_run_folder_is_never_overwritten(play: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(UsageError, match=r"no training run at .* to resume"):
        train(config(play), out, resume=True)
    train(config(play, steps=1), out)
    with pytest.raises(UsageError, match=r"is there already.*--resume"):
        train(config(play), out)
    with pytest.raises(UsageError, match="another lr, seed: give the same"):
        train(config(play, lr=0.1, seed=3), out, resume=True)
    train(config(play, steps=2), out, resume=True)  # more of the same is no other run
    assert metrics(out)[-1]["step"] == 2


def test_a_store_without_the_cameras_is_refused_with_the_command_that_draws_them(tmp_path: Path) -> None:
    make_store(tmp_path / "blind", np.random.default_rng(0), episodes=2, steps=60)
    with pytest.raises(
        UsageError, match=r"no images of front, wrist \(it has: none\); `playlearn render .*blind OUT --camera front="
    ):
        train(config(tmp_path / "blind", "cnn"), tmp_path / "run")
    with pytest.raises(StoreError):
        train(config(tmp_path / "nowhere"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_torn_checkpoint_is_one_message(play: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    train(config(play), out)
    file = out / "checkpoint" / "last.safetensors"
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="cannot be read"):
        train(config(play, steps=6), out, resume=True)


@pytest.mark.parametrize("field", ["batch_size", "steps", "lr", "max_minutes", "ema_decay", "threads"])
def test_numbers_out_of_range_name_their_field(field: str, play: Path) -> None:
    with pytest.raises(UsageError, match=field):
        config(play, **{field: -1})


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_config_in_the_repository_is_valid(path: Path) -> None:
    settings = load_config(TrainConfig, path)
    assert settings == dataclasses.replace(settings)
    assert settings.resolved().data.chunk == settings.policy.chunk
