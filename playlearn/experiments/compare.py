"""`playlearn compare`: variants of one training config, on the same play, evaluated on the same episodes.

Every (variant, seed) is trained and evaluated in a folder of its own, by one process of one thread, so that times
compare; what is finished is not done again. In the end each variant's latency is measured, with no other job running.
"""

import contextlib
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from playlearn.batch import Inputs
from playlearn.config import (
    Digests,
    RunFolder,
    atomic_write,
    atomic_write_all,
    git_revision,
    held,
    json_digest,
    load_config,
    make_folder,
    save_config,
    to_dict,
    versions,
)
from playlearn.errors import NotLearnedError, PlaylearnError, UsageError
from playlearn.evaluation import evaluate, load_suite
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.policies import Policy
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.report.compared import plot, table
from playlearn.report.intervals import wilson
from playlearn.report.progress import Progress
from playlearn.store import open_store
from playlearn.training import TrainConfig, train

Row = dict[str, Any]
_CHUNKS = 100  # from which the latency's quantiles are taken, after a few for warm-up


@dataclass(frozen=True)
class CompareConfig:
    """What is compared.

    base: YAML of the training config that all variants start from.
    suite: what all are evaluated on.
    variants: name -> the fields in which each differs (`policy.head.type: diffusion`), as on the command line.
    common: fields of `base` that are set differently here, for all.
    goal: how goals are shown.
    episodes: of each evaluation.
    eval_seed: of each evaluation.
    n_action_steps: actions of a chunk that are executed before the next plan (null: the suite's).
    seeds: of training; each trains every variant.
    """

    base: Path
    suite: Path
    variants: dict[str, dict[str, Any]]
    common: dict[str, Any] = field(default_factory=dict)
    goal: Literal["image", "state"] = "state"
    episodes: int = 102
    eval_seed: int = 1000
    n_action_steps: int | None = None
    seeds: tuple[int, ...] = (0,)

    def training(self, variant: str, seed: int) -> TrainConfig:
        """The config of one run; raises UsageError where a field is wrong."""
        fields = {**self.common, **self.variants[variant], "seed": seed}
        given = [f"--{name}={json.dumps(value)}" for name, value in fields.items()]
        try:
            return load_config(TrainConfig, self.base, given)
        except UsageError as error:
            raise UsageError(f"variant {variant!r}: {error}") from error


def compare(config: CompareConfig, out: Path, workers: int | None = None) -> list[Row]:
    """Train and evaluate what is not there yet; leave results.json, table.md, plot.png in `out`, the runs under runs/.

    Returns one row a variant.

    Raises:
        UsageError: a variant's config is wrong, or `out` holds another comparison or one on other data.
        BusyError: another process writes into `out`.
        DiskError: the disk is full; the runs that are done are kept.
        PlaylearnError: a run failed; the others are kept, and the same command continues from there.
    """
    if not config.variants or not config.seeds:
        raise UsageError("there is nothing to compare: give `variants` and `seeds`")
    runs = {(name, seed): config.training(name, seed) for name in config.variants for seed in config.seeds}
    with held(out):
        _claim(config, runs, out)
        return _run(config, runs, out, workers)


def _run(
    config: CompareConfig, runs: Mapping[tuple[str, int], TrainConfig], out: Path, workers: int | None
) -> list[Row]:
    jobs = [
        Job(key, _one, {"training": training, "folder": _folder(out, *key), "compare": config}, seed=key[1])
        for key, training in sorted(runs.items(), key=lambda item: config.seeds.index(item[0][1]))
    ]
    rows: dict[tuple[str, int], Row] = {}
    failed: list[str] = []
    with (
        LocalExecutorConfig(workers=workers).build() as executor,
        Progress(out.name, len(jobs), "run", workers=executor.workers) as progress,
    ):
        for result in executor.run(jobs, keep_going=True):
            name, seed = result.key
            if result.error is None:
                rows[result.key] = result.value
                progress.say(f"{name}, seed {seed}: {result.value['success_rate']:.1%}")
            else:
                failed.append(f"{name}, seed {seed}: {result.error}")
            progress.to(len(rows) + len(failed), seconds=result.seconds)
    if failed:
        raise PlaylearnError(f"{len(failed)} of {len(jobs)} runs failed, the rest is kept: " + "; ".join(failed))
    timed = [Job(name, _latency, {"path": _folder(out, name, config.seeds[0]) / "policy"}) for name in config.variants]
    with LocalExecutorConfig(workers=0 if workers == 0 else 1).build() as executor:
        latencies = {result.key: result.value for result in executor.run(timed)}
    gathered = [_gather(name, [rows[name, seed] for seed in config.seeds], latencies[name]) for name in config.variants]
    results = {
        "config": to_dict(config),
        "rows": gathered,
        "versions": versions(),
        "git_revision": git_revision(),
    }
    atomic_write_all(
        {
            out / "results.json": json.dumps(results, indent=1, default=str).encode(),
            out / "table.md": table(gathered).encode(),
        }
    )
    plot(gathered, out / "plot.png")
    return gathered


def _claim(config: CompareConfig, runs: Mapping[tuple[str, int], TrainConfig], out: Path) -> None:
    # A variant or a seed may be added or left out; the runs that are there stay.
    folder = RunFolder(out, "compare.yaml", "comparison", adjustable=("seeds",), entries=("variants",))
    begun = folder.begun()
    if begun:
        folder.check_same(to_dict(load_config(CompareConfig, folder.file), out), to_dict(config, out))
    inputs = _inputs(config, runs, out)
    if begun:
        folder.check_inputs(inputs)
    folder.keep_inputs({**folder.inputs(), **inputs})
    save_config(config, folder.file)


def _inputs(config: CompareConfig, runs: Mapping[tuple[str, int], TrainConfig], out: Path) -> Digests:
    """What the runs read, by digest: their training configs, all of which start from `base`, the suite and the play."""
    stores = {json.dumps(to_dict(training, out)["store"]): training.store for training in runs.values()}
    return {
        "suite": {config.suite.name: json_digest(to_dict(load_suite(config.suite), out))},
        **{
            f"{name}, seed {seed}": {"training config": json_digest(to_dict(run, out))}
            for (name, seed), run in runs.items()
        },
        **{f"store {name}": open_store(store).digests() for name, store in stores.items()},
    }


def _folder(out: Path, name: str, seed: int) -> Path:
    return out / "runs" / f"{name.replace(' ', '_').replace('/', '_')}-{seed}"


def _one(training: TrainConfig, folder: Path, compare: CompareConfig) -> Row:
    """Train and evaluate one variant under one seed, or read its row from an earlier call."""
    done = folder / "row.json"
    if done.is_file():
        row: Row = json.loads(done.read_text())
        return row
    make_folder(folder)
    with (folder.parent / f"{folder.name}.log").open("a") as log, contextlib.redirect_stderr(log):
        began, resumed = time.process_time(), (folder / "config.yaml").is_file()
        try:
            train(training, folder, resume=resumed)
        except NotLearnedError as error:  # a comparison may hold one that learns nothing: its row shows it
            print(error, file=log, flush=True)
        core_seconds = None if resumed else round(time.process_time() - began, 1)  # unknown for an interrupted one
        results = evaluate(
            compare.suite,
            run=folder,
            goal=compare.goal,
            out=folder / "eval",
            episodes=compare.episodes,
            seed=compare.eval_seed,
            workers=0,
            references=False,
            overrides=[] if compare.n_action_steps is None else [f"--n_action_steps={compare.n_action_steps}"],
        )
    metrics = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    val = [line["val/action_error"] for line in metrics if "val/action_error" in line]
    kept = ("success_rate", "episodes", "tasks", "crashed", "renderer", PRIVILEGED)
    row = {name: results[name] for name in kept} | {
        "parameters": json.loads((folder / "run.json").read_text())["parameters"],
        "updates": metrics[-1]["step"],
        "train_seconds": metrics[-1]["seconds"],
        "train_core_seconds": core_seconds,
        "eval_seconds": results["seconds"],
        "val_action_error": val[-1] if val else None,
    }
    atomic_write(done, json.dumps(row, indent=1).encode())
    return row


def _gather(name: str, rows: Sequence[Row], latency: Mapping[str, float]) -> Row:
    """One variant's seeds together: the interval treats all episodes as one run's."""
    episodes = sum(row["episodes"] for row in rows)
    successes = sum(round(row["success_rate"] * row["episodes"]) for row in rows)
    tasks = {
        task: float(np.mean([row["tasks"][task]["success_rate"] for row in rows if task in row["tasks"]]))
        for task in sorted({task for row in rows for task in row["tasks"]})
    }
    return {
        "variant": name,
        "success_rate": successes / episodes,
        "ci95": list(wilson(successes, episodes)),
        "episodes": episodes,
        "by_seed": [row["success_rate"] for row in rows],
        "crashed": sum(row["crashed"] for row in rows),
        PRIVILEGED: rows[0].get(PRIVILEGED),
        "parameters": rows[0]["parameters"],
        "updates": rows[0]["updates"],
        "train_core_seconds": _mean(row["train_core_seconds"] for row in rows),
        "val_action_error": _mean(row["val_action_error"] for row in rows),
        "latency_ms": dict(latency),
        "tasks": tasks,
    }


def _mean(values: Iterable[float | None]) -> float | None:
    """The mean of those that are known."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _latency(path: Path) -> dict[str, float]:
    """Milliseconds for one chunk, observation to actions, on one core: median and 95th percentile."""
    policy = Policy.load(path)
    inputs, generator = blank(policy), torch.Generator().manual_seed(0)
    times = []
    for _ in range(_CHUNKS + 10):
        began = time.perf_counter()
        policy.act(inputs, generator)
        times.append(1000 * (time.perf_counter() - began))
    p50, p95 = np.quantile(times[10:], (0.5, 0.95))
    return {"p50": float(p50), "p95": float(p95)}


def blank(policy: Policy) -> Inputs:
    """One example of a policy's inputs: all numbers at the data's mean, all images black."""
    spec, encoder, steps = policy.spec, policy.config.encoder, policy.config.history
    state, achieved = policy.normalizer.get_buffer("state_mean"), policy.normalizer.get_buffer("achieved_mean")

    def black(camera: str, *lead: int) -> torch.Tensor:
        return torch.zeros(*lead, *spec.cameras[camera], 3, dtype=torch.uint8)

    return Inputs(
        state=state.expand(1, steps, -1),
        achieved=achieved.expand(1, steps, -1),
        history_mask=torch.ones(1, steps, dtype=torch.bool),
        goal_achieved=achieved.expand(1, -1),
        goal_proprio=state.expand(1, -1),
        images={camera: black(camera, 1, steps) for camera in encoder.observation_cameras},
        goal_images={camera: black(camera, 1) for camera in encoder.goal_cameras},
    )
