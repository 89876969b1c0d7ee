"""Every writer on a disk that fills up: `python full_disk.py ROOMY_FOLDER SMALL_DISK [WRITER ...]`, in one process.

A filler leaves a writer so many pages, more from try to try, until it comes through. Each failure must be a DiskError
that names a folder on that disk, and must leave every file that was whole as it was and nothing unfinished. Prints
one JSON line: writer -> how many tries failed.
"""

import contextlib
import io
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from playlearn.collection import render_store
from playlearn.collection.scenes import render_scenes
from playlearn.config import from_dict, save_config
from playlearn.dagger import DaggerConfig, dagger
from playlearn.data import ScenesConfig
from playlearn.errors import PlaylearnError
from playlearn.evaluation import evaluate
from playlearn.evaluation.diagnosis import diagnose
from playlearn.experiments import compare as comparison
from playlearn.lerobot.publish import export_policy
from playlearn.lerobot.share import contents, share
from playlearn.report.store_report import write_report
from playlearn.report.timeline import timeline
from playlearn.report.view import view_episode
from playlearn.sim import CameraConfig
from playlearn.store import Store
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot import LeRobotStoreConfig
from playlearn.store.lerobot.recordings import LeRobotRecordings
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import SUITE, play
from tests.fakes import PointConfig, PointEnv, point_expert
from tests.synthetic import make_store

PAGE = 4096
TEMPORARY = (".tmp", ".building", ".lock")


@dataclass
class Disk:
    """A small disk."""

    folder: Path

    def fill(self, pages: int) -> None:
        """Leave so many pages free."""
        with (self.folder / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(PAGE))
        size = (self.folder / "filler").stat().st_size
        os.truncate(self.folder / "filler", max(0, size - pages * PAGE))

    def files(self) -> dict[str, bytes]:
        """The content of each, but for the filler."""
        paths = [path for path in self.folder.rglob("*") if path.is_file() and path.name != "filler"]
        return {str(path.relative_to(self.folder)): path.read_bytes() for path in paths}


def sweep(disk: Disk, act: Callable[[], Any], growing: tuple[str, ...]) -> int:
    """Let it run with more and more room until it comes through; how often it failed.

    growing: names of files that may be longer after a failure.
    """
    pages, failed = 0, 0
    while True:
        before = disk.files()
        disk.fill(pages)
        try:
            act()
        except PlaylearnError as error:  # a comparison counts the runs that failed, and says why each did
            message = str(error)
        else:
            return failed
        assert f"{disk.folder}" in message, message
        assert "the disk is full" in message, message
        assert pages * PAGE < shutil.disk_usage(disk.folder).total, "too small a disk for it"
        failed, pages = failed + 1, 8 * pages + 1
        after = disk.files()
        left = [name for name in disk.folder.rglob("*") if name.name.endswith(TEMPORARY)]
        assert left == [], f"{left} with {pages} pages"
        for name, content in before.items():
            if not name.endswith(growing):
                assert name not in after or after[name] == content or _whole(disk.folder / name), name


def _whole(path: Path) -> bool:
    """Whether a file that was replaced is whole: those of a job that was run again may differ."""
    if path.suffix == ".json":
        json.loads(path.read_text())
    return path.stat().st_size > 0


def writers(roomy: Path, disk: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Each writer, with what it writes into a folder of its own name."""
    store = play(roomy / "play", 4)
    images = make_store(roomy / "images", np.random.default_rng(0), 2, 12, ("front",))
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
    yield "render", lambda: render_store(store.path, disk / "render", {"front": CameraConfig(24, 32)}, workers=0)
    scenes, none = ScenesConfig(per_episode=2), np.zeros(len(store), np.bool_)
    yield "scenes", lambda: render_scenes(scenes, store, none, ("front",), disk / "scenes", workers=0)
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
    for suffix in (".html", ".json", ".md", ".png"):
        report = disk / "pages" / f"report{suffix}"
        yield f"info --report {suffix}", partial(write_report, images, report, lambda: PointEnv(PointConfig()))
    yield "view --save .png", lambda: timeline(images, 0, disk / "view.png")
    yield "view --save .rrd", lambda: view_episode(images.path, 0, save=disk / "view.rrd")
    yield "config", lambda: save_config(training, disk / "config.yaml")


def main(roomy: Path, small: Path, only: list[str]) -> dict[str, int]:
    torch.set_num_threads(1)
    disk, failures = Disk(small), {}
    for name, act in writers(roomy, small):
        if only and name not in only:
            continue
        print(f"== {name}", file=sys.stderr, flush=True)
        failures[name] = sweep(disk, act, ("metrics.jsonl", ".log"))
        if name != "eval":
            for path in small.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    return failures


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):
        found = main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    print(json.dumps(found))
