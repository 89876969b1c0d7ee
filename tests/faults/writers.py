"""Every place at which playlearn writes files, small enough to be tried again and again; for `full_disk.py`.

`doctor` and `completion` write none.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from PIL import Image

from playlearn.collection import CollectConfig, collect, record_teleoperation, render_store
from playlearn.collection.corrections import make_corrections
from playlearn.collection.perceived import make_perceived
from playlearn.collection.scenes import render_scenes
from playlearn.config import atomic_write, from_dict, make_folder, save_config
from playlearn.dagger import DaggerConfig, dagger
from playlearn.data import CorrectionsConfig, ScenesConfig
from playlearn.data.perceived import PerceivedConfig
from playlearn.demo import DemoConfig, demo
from playlearn.demo import job as demo_job
from playlearn.demo.commands import Done
from playlearn.demo.reference import Reference
from playlearn.evaluation import evaluate, join_runs
from playlearn.evaluation.diagnosis import diagnose
from playlearn.experiments import compare as comparison
from playlearn.experiments.toy import run as run_toy
from playlearn.experiments.toy.base import Experiment, ToyExperiment
from playlearn.lerobot.goals import RelabelConfig
from playlearn.lerobot.publish import export_policy
from playlearn.lerobot.share import contents, share
from playlearn.process_cache import cached_env
from playlearn.relabeling import FutureConfig
from playlearn.report.figure import save_picture
from playlearn.report.store_report import write_report
from playlearn.report.timeline import timeline
from playlearn.report.view import view_episode
from playlearn.sim import CameraConfig
from playlearn.store import NativeStore, Store
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot import LeRobotStoreConfig
from playlearn.store.lerobot.recordings import LeRobotRecordings
from playlearn.store.robomimic import RobomimicFile
from playlearn.store.robomimic_export import export_robomimic
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import SUITE, play
from tests.fakes import PointConfig, PointEnv, point_expert
from tests.faults import point
from tests.policies.test_behind import SEEING
from tests.policies.test_behind import config as behind
from tests.synthetic import make_store
from tests.teleop.test_device import Blind, Looking, Scripted, actor, moving

ROOT = Path(__file__).parents[2]
DEMO_CONFIGS = ("collect", "state", "encoder", "dagger", "suite")

type Writers = Iterator[tuple[str, Callable[[], Any]]]


def writers(roomy: Path, disk: Path) -> Writers:
    """Each writer, with what it writes into a folder of its own name on `disk`; what it reads is made in `roomy`."""
    store = play(roomy / "play", 4)
    images = make_store(roomy / "images", np.random.default_rng(0), 2, 12, ("front",))
    yield from _recorders(disk)
    yield from _jobs(store, roomy, disk)
    yield from _makers(store, roomy, disk)
    yield from _exports(images, roomy, disk)
    yield from _pages(images, disk)


def _recorders(disk: Path) -> Writers:
    point.install()

    def go_on(name: str) -> bool:
        return (disk / name / "store.json").is_file()

    yield "collect", lambda: collect(point.config(2), disk / "collect", workers=0, resume=go_on("collect"))
    wanted = CollectConfig(episodes=2, steps=4)

    def recorded() -> None:
        env: Any = Blind(cached_env(wanted.environment))
        person = actor(Scripted(moving(40)), env, Looking())
        record_teleoperation(wanted, disk / "device", env, person, resume=go_on("device"))

    yield "collect --device", recorded


def _jobs(store: NativeStore, roomy: Path, disk: Path) -> Writers:
    """Those that train and evaluate."""
    save_config(replace(SUITE, episodes=2, environment=PointConfig()), roomy / "suite.yaml")
    fields = {
        "store": str(store.path),
        "data": {"val_fraction": 0.5},
        "policy": {"encoder": {"type": "state", "hidden": 8}, "trunk": {"type": "mlp", "width": 16}, "chunk": 4},
        "batch_size": 8,
        "steps": 4,
        "checkpoint_every": 2,
        "log_every": 1,
        "val_batches": 1,
        "init_from": None,
        "cpu": True,
    }
    training = from_dict(TrainConfig, fields)
    train(replace(training, steps=40, lr=2e-3, warmup=5), roomy / "run")
    training = replace(training, init_from=roomy / "run")  # so that it need not learn anything

    def trained() -> None:
        train(training, disk / "train", resume=(disk / "train" / "config.yaml").is_file())

    yield "train", trained
    common: dict[str, Any] = {"workers": 0, "expert": point_expert}
    suite = roomy / "suite.yaml"
    yield "eval", lambda: evaluate(suite, run=roomy / "run", goal="state", out=disk / "eval", **common)
    yield "eval again", lambda: evaluate(suite, run=roomy / "run", goal="state", out=disk / "eval", **common)
    yield "diagnose", lambda: diagnose(roomy / "run", suite, disk / "diagnose", goal="state", **common)
    rounds = from_dict(
        DaggerConfig,
        {
            "rollout_suite": str(suite),
            "rounds": 1,
            "episodes": 4,
            "policy_steps": [2, 5],
            "finish_steps": 60,
            "success_hold_steps": 2,
            "updates": 2,
            "eval_episodes": 1,
            "eval_seed": 9,
            "cpu": True,
        },
    )

    def gathered() -> None:
        dagger(rounds, roomy / "run", disk / "dagger", resume=(disk / "dagger/dagger.yaml").is_file(), **common)

    yield "dagger", gathered
    comparison.evaluate = partial(evaluate, expert=point_expert)  # type: ignore[attr-defined]
    save_config(training, roomy / "base.yaml")
    compared = comparison.CompareConfig(base=roomy / "base.yaml", suite=suite, variants={"a": {}}, episodes=1)
    yield "compare", lambda: comparison.compare(compared, disk / "compare", workers=0)
    heads = {"head": {"type": "deterministic", "loss": "mse"}}
    fork = {"type": "fork", "heads": heads, "training": {"updates": 1}, "samples": 8}
    experiment: Experiment = from_dict(ToyExperiment, {"experiment": fork}).experiment
    yield "toy", lambda: run_toy(experiment, disk / "toy", lambda _: None)
    yield "demo", lambda: _demo(disk / "demo")


def _demo(out: Path) -> None:
    """A demo whose commands are quick: only what it reads of them is there."""
    metrics = json.dumps({"step": 1, "val/head": 0.0, "val/achieved": 0.0})
    rates = {"success_rate": 1.0, "ci95": [0.9, 1.0], "episodes": 2}
    results = json.dumps({**rates, "references": {"random": {**rates, "ci95": [0.0, 0.1]}}})
    left = {"policy": ("state/metrics.jsonl", metrics), "encoder": ("encoder/metrics.jsonl", metrics)}
    left |= {"eval": ("eval/results.json", results)}

    def run(commands: Mapping[str, Sequence[str]], *_: object, **__: object) -> dict[str, Done]:
        for place, text in [left[name] for name in commands if name in left]:
            make_folder((out / place).parent)
            atomic_write(out / place, text.encode())
        return {name: Done(0, 1.0, 1.0) for name in commands}

    config = DemoConfig(**{name: ROOT / getattr(DemoConfig, name) for name in DEMO_CONFIGS})  # type: ignore[arg-type]
    names = {"run_together": run, "measure": lambda: Reference(1.0, 1.0), "join_runs": lambda *_: None}
    with ExitStack() as stack:
        for name, value in names.items():
            stack.enter_context(patch.object(demo_job, name, value))
        demo(config, out, say=lambda _: None)


def _makers(store: NativeStore, roomy: Path, disk: Path) -> Writers:
    """Those that make something of each episode, or of two runs."""
    none = np.zeros(len(store), np.bool_)
    yield "render", lambda: render_store(store.path, disk / "render", {"front": CameraConfig(24, 32)}, workers=0)
    scenes = ScenesConfig(per_episode=2)
    yield "scenes", lambda: render_scenes(scenes, store, none, ("front",), disk / "scenes", workers=0)

    @cache
    def runs() -> tuple[Path, Path]:
        """A state policy and an image encoder."""
        render_scenes(ScenesConfig(per_episode=6), store, none, ("front", "wrist"), roomy / "scenes", workers=0)
        train(behind(roomy, {"type": "state", "hidden": 16}), roomy / "state")
        learned = ["encoder.front.*", "encoder.others.*", "encoder.estimate.*"]
        seen = {"per_episode": 6, "folder": str(roomy / "scenes")}
        train(behind(roomy, SEEING, trainable=learned, scenes=seen), roomy / "encoder")
        return roomy / "state", roomy / "encoder"

    yield "estimates", lambda: make_perceived(PerceivedConfig(runs()[1]), store, disk / "estimates", workers=0)
    yield "join", lambda: join_runs(*runs(), disk / "join")
    sample, wanted = NativeStore.open(ROOT / "datasets" / "sample"), CorrectionsConfig(fraction=0.5, per_episode=2)
    yield (
        "corrections",
        lambda: make_corrections(wanted, sample, np.arange(1), ("wrist",), disk / "corrections", workers=0),
    )
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8))
    yield "bench --out", lambda: save_picture(picture, disk / "compared.png")


def _exports(images: NativeStore, roomy: Path, disk: Path) -> Writers:
    """Those that write for others, and read what others wrote."""
    goals = RelabelConfig(goals=FutureConfig())
    yield "export robomimic", lambda: export_robomimic(images, disk / "play.hdf5", {"train": [0]})
    yield "export lerobot --goals", lambda: share(contents(images, goals), disk / "goals", None)
    yield "export lerobot --subtasks", lambda: share(contents(images, subtasks=True), disk / "subtasks", None)
    yield "export lerobot", lambda: share(contents(images), disk / "lerobot", None)
    yield "export lerobot --videos", lambda: share(contents(images), disk / "videos", "h264")
    yield "export policy", lambda: export_policy(roomy / "run", disk / "policy")

    @cache
    def exported() -> Path:
        share(contents(images), roomy / "lerobot", None)
        return roomy / "lerobot"

    def opened(frames: Path) -> Store:
        return LeRobotStoreConfig(root=exported(), cache=frames).build()

    yield "import", lambda: import_recordings(LeRobotRecordings(opened(roomy / "cache")), disk / "import")
    yield "decoded frames", lambda: opened(disk / "frames").read(0)

    @cache
    def demonstrations() -> Path:
        export_robomimic(images, roomy / "play.hdf5", {})
        return roomy / "play.hdf5"

    yield "import robomimic", lambda: import_recordings(RobomimicFile(demonstrations()), disk / "robomimic")


def _pages(images: NativeStore, disk: Path) -> Writers:
    """Those that show something, and a config."""
    for suffix in (".html", ".json", ".md", ".png"):
        report = disk / "pages" / f"report{suffix}"
        yield f"info --report {suffix}", partial(write_report, images, report, lambda: PointEnv(PointConfig()))
    yield "view --save .png", lambda: timeline(images, 0, disk / "view.png")
    yield "view --save .rrd", lambda: view_episode(images.path, 0, save=disk / "view.rrd")
    yield "config", lambda: save_config(SUITE, disk / "config.yaml")
