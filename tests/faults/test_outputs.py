"""One output, one writer; and a job that goes on knows when its data are not those it was begun with."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn import cli
from playlearn.collection import render_store
from playlearn.collection.scenes import render_scenes
from playlearn.config import from_dict, held, load_config, save_config
from playlearn.dagger import DaggerConfig, dagger
from playlearn.dagger import job as dagger_job
from playlearn.data import ScenesConfig
from playlearn.demo import DemoConfig, demo
from playlearn.demo import job as demo_job
from playlearn.errors import BusyError, UsageError
from playlearn.evaluation import evaluate, join_runs
from playlearn.evaluation.diagnosis import diagnose
from playlearn.experiments import compare as comparison
from playlearn.experiments.toy import load_experiment
from playlearn.experiments.toy import run as run_toy
from playlearn.lerobot.publish import export_policy
from playlearn.lerobot.share import contents, share
from playlearn.policies import Policy, PolicyConfig
from playlearn.process_cache import cached_store
from playlearn.sim import CameraConfig
from playlearn.store import NativeStore, write_episode
from playlearn.store.importing import import_recordings
from playlearn.store.robomimic import RobomimicFile
from playlearn.store.robomimic_export import export_robomimic
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import SUITE, play, spec
from tests.fakes import point_expert
from tests.policies.parts import small

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Play, a suite, the config of a training on it, and its untrained policy."""
    folder = tmp_path_factory.mktemp("outputs")
    play(folder / "play", 4)
    save_config(SUITE, folder / "suite.yaml")
    (folder / "run").mkdir()
    save_config(training(folder), folder / "run" / "config.yaml")
    PolicyConfig(chunk=4).build(spec(), None, seed=0).save(folder / "run" / "policy")
    return folder


def training(folder: Path, **more: Any) -> TrainConfig:
    fields = {
        "store": str(folder / "play"),
        "data": {"val_fraction": 0.0},
        "policy": {"encoder": small("state"), "trunk": small("mlp"), "head": small("deterministic"), "chunk": 4},
        "batch_size": 8,
        "steps": 1,
        "cpu": True,
    }
    return from_dict(TrainConfig, fields | more)


def rounds(folder: Path, **more: Any) -> DaggerConfig:
    return from_dict(DaggerConfig, {"rollout_suite": str(folder / "suite.yaml"), "eval_seed": 9, "cpu": True} | more)


def compared(folder: Path) -> comparison.CompareConfig:
    save_config(training(folder), folder / "base.yaml")
    return comparison.CompareConfig(base=folder / "base.yaml", suite=folder / "suite.yaml", variants={"a": {}})


def drawn(store: NativeStore, out: Path) -> None:
    render_scenes(ScenesConfig(per_episode=1), store, np.zeros(len(store), np.bool_), ("front",), out, workers=0)


def jobs(made: Path, out: Path) -> dict[str, Callable[[], object]]:
    run, suite, common = made / "run", made / "suite.yaml", {"workers": 0, "expert": point_expert}
    store = NativeStore.open(made / "play")
    return {
        "train": lambda: train(training(made), out),
        "eval": lambda: evaluate(suite, run=run, goal="state", out=out, **common),  # type: ignore[arg-type]
        "diagnose": lambda: diagnose(run, suite, out, goal="state", **common),  # type: ignore[arg-type]
        "dagger": lambda: dagger(rounds(made), run, out, **common),  # type: ignore[arg-type]
        "compare": lambda: comparison.compare(compared(made), out, workers=0),
        "demo": lambda: demo(DemoConfig(), out),
        "toy": lambda: run_toy(load_experiment(CONFIGS / "toy" / "fork.yaml", []), out, print),
        "render": lambda: render_store(store.path, out, {"front": CameraConfig(24, 32)}, workers=0),
        "scenes": lambda: drawn(store, out),
        "join": lambda: join_runs(run, run, out),
        "import": lambda: imported(made, out),
    }


def imported(made: Path, out: Path) -> NativeStore:
    """The play, by way of robomimic's format."""
    pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
    if not (made / "play.hdf5").exists():
        robomimic(NativeStore.open(made / "play"), made / "play.hdf5")
    return import_recordings(RobomimicFile(made / "play.hdf5"), out)


def robomimic(store: NativeStore, out: Path) -> None:
    export_robomimic(store, out, {})


def lerobot(store: NativeStore, out: Path) -> None:
    share(contents(store), out, None)


@pytest.mark.parametrize(
    "job", ["train", "eval", "diagnose", "dagger", "compare", "demo", "toy", "render", "scenes", "join", "import"]
)
def test_a_second_process_is_refused_and_writes_nothing(made: Path, tmp_path: Path, job: str) -> None:
    out = tmp_path / "out"
    act = jobs(made, out)[job]
    with held(out):
        with pytest.raises(BusyError, match=r"out is being written by another process: wait for it to end"):
            act()
        assert [path.name for path in out.iterdir() if path.name != "episodes"] == [".lock"]


def test_an_import_that_goes_on_is_refused_beside_another(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    imported(made, out)
    (out / "episodes" / "000003.safetensors").unlink()
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    with held(out):
        with pytest.raises(BusyError, match=r"out is being written by another process: wait for it to end"):
            imported(made, out)
        assert {
            path: path.stat().st_mtime_ns for path in out.rglob("*") if path.name != ".lock" and path.is_file()
        } == before
    assert len(imported(made, out)) == 4


@pytest.mark.parametrize("export", [export_policy, lerobot, robomimic])
def test_a_second_export_is_refused(made: Path, tmp_path: Path, export: Callable[[Any, Path], object]) -> None:
    if export is robomimic:
        pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
    source = made / "run" if export is export_policy else NativeStore.open(made / "play")
    with held(tmp_path / ".out.building"), pytest.raises(BusyError, match="is being written by another process"):
        export(source, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == []


def test_the_command_says_it_in_one_sentence(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["train", "--config", str(made / "run" / "config.yaml"), "--out", str(tmp_path / "out")]
    with held(tmp_path / "out"):
        assert cli.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"playlearn: {tmp_path / 'out'} is being written by another process: wait")


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    """The same in a folder that a test may change."""
    shutil.copytree(made, tmp_path / "copy")
    return tmp_path / "copy"


def change(store: Path) -> None:
    """Another episode 0 of the same length, and episode 2 under the number 7."""
    opened = NativeStore.open(store)
    write_episode(store, 0, replace(opened.read(0), state=opened.read(0).state + np.float32(0.01)))
    (store / "episodes" / "000002.safetensors").rename(store / "episodes" / "000007.safetensors")


CHANGED = r"store.*: 1 added \(episode 7\), 1 removed \(episode 2\), 1 changed \(episode 0\)\. Put it back as it was"


def test_a_training_knows_its_data(copy: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    more = {"store": str(copy / "play"), "fraction": 0.3}
    settings = {"init_from": str(copy / "base"), "extra_datasets": [more]}
    train(training(copy), copy / "base")
    train(training(copy, **settings), out)
    train(training(copy, **settings, steps=2), out, resume=True)
    change(copy / "play")
    with pytest.raises(UsageError, match=rf"out was begun with other inputs: extra_datasets\.0\.{CHANGED[:20]}"):
        train(training(copy, **settings, steps=3), out, resume=True)
    shutil.rmtree(copy / "play")
    play(copy / "play", 4)
    train(training(copy, **settings, steps=3), out, resume=True)
    Policy.load(copy / "run" / "policy").save(copy / "base" / "policy")
    with pytest.raises(UsageError, match=r"init_from: .*changed \(policy\.safetensors"):
        train(training(copy, **settings, steps=4), out, resume=True)


def test_dagger_knows_its_data(copy: Path, tmp_path: Path) -> None:
    def claim(resume: bool = True) -> None:
        job = dagger_job._Job(rounds(copy), copy / "run", tmp_path / "out", 0, point_expert)
        with held(tmp_path / "out"):
            dagger_job._claim(job, resume=resume)

    claim(resume=False)
    claim()
    save_config(replace(SUITE, max_steps=7), copy / "suite.yaml")
    with pytest.raises(UsageError, match=r"begun with other inputs: suites: 2 changed \(rollout_suite, suite\)"):
        claim()
    save_config(SUITE, copy / "suite.yaml")
    change(copy / "play")
    with pytest.raises(UsageError, match=f"begun with other inputs: {CHANGED}"):
        claim()


def test_a_comparison_knows_its_data(copy: Path, tmp_path: Path) -> None:
    """`base` is read each time: another one would be trained beside runs that are done."""

    def claim(config: comparison.CompareConfig) -> None:
        with held(tmp_path / "out"):
            comparison._claim(config, {("a", 0): config.training("a", 0)}, tmp_path / "out")

    config = compared(copy)
    claim(config)
    claim(config)
    save_config(training(copy, steps=5), copy / "base.yaml")
    with pytest.raises(UsageError, match=r"begun with other inputs: a, seed 0: 1 changed \(training config\)"):
        claim(config)
    compared(copy)
    change(copy / "play")
    with pytest.raises(UsageError, match=f"begun with other inputs: {CHANGED}"):
        claim(config)


def test_a_demo_knows_its_configs(tmp_path: Path) -> None:
    files = {name: tmp_path / f"{name}.yaml" for name in ("collect", "state", "encoder", "dagger", "suite")}
    for path in files.values():
        path.write_text("one")
    job = demo_job._Demo(DemoConfig(**files), tmp_path / "out", None, print)
    with held(tmp_path / "out"):
        job.claim()
        job.claim()
        files["state"].write_text("another")
        with pytest.raises(UsageError, match=r"begun with other inputs: state: 1 changed \(state\.yaml\)"):
            job.claim()


@pytest.mark.parametrize("maker", ["render", "scenes"])
def test_what_is_made_of_episodes_is_made_of_the_same_ones(copy: Path, tmp_path: Path, maker: str) -> None:
    """More episodes may come; those that were looked at must stay as they were."""
    out = tmp_path / "out"

    def make() -> None:
        cached_store.cache_clear()  # what a process of its own does not need
        store = NativeStore.open(copy / "play")
        if maker == "render":
            render_store(store.path, out, {"front": CameraConfig(24, 32)}, workers=0)
        else:
            drawn(store, out)

    make()
    with NativeStore.open(copy / "play").writer() as writer:
        writer.append(NativeStore.open(copy / "play").read(1))
    make()
    assert len(list((out / "episodes").iterdir())) == 5
    change(copy / "play")
    with pytest.raises(UsageError, match=r"begun with another episodes\.episode 0: give the same"):
        make()


def test_a_run_goes_on_from_any_folder(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begun with a relative path; resumed from elsewhere, and after all was moved; never by another store's data."""
    monkeypatch.chdir(copy)
    train(replace(training(copy), store=Path("play")), Path("out"))
    assert str(copy) not in (copy / "out" / "config.yaml").read_text()
    monkeypatch.chdir(tmp_path)
    train(training(copy, steps=2), copy / "out", resume=True)
    with pytest.raises(UsageError, match="begun with another store"):
        train(replace(training(copy, steps=3), store=Path("play")), copy / "out", resume=True)
    copy.rename(tmp_path / "moved")
    recorded = load_config(TrainConfig, tmp_path / "moved" / "out" / "config.yaml")
    train(replace(recorded, steps=3), tmp_path / "moved" / "out", resume=True)
