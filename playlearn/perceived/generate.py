"""Look at moments of a store's episodes through an image encoder, on all cores; an interrupted look goes on."""

import functools
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import playlearn.envs  # noqa: F401 - registers the environments
from playlearn.batch import Inputs
from playlearn.config import from_dict
from playlearn.episode import Array, Observation
from playlearn.errors import CheckpointError
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.perceived.config import PerceivedConfig
from playlearn.policies import Policy
from playlearn.policies.policy import WEIGHTS
from playlearn.report.progress import Progress
from playlearn.sim import Environment, EnvironmentConfig
from playlearn.store import Store, episode_path, open_store
from playlearn.store.folder import claim
from playlearn.store.tensors import write_tensors

NOTE = "perceived.json"


def make_perceived(config: PerceivedConfig, store: Store, folder: Path, workers: int | None = None) -> None:
    """Leave in `folder` a file for each episode of the store; those that are there already stay.

    A file holds of n moments: t (n,), observed (n, G) and wanted (n, G), what the encoder takes `achieved` for in the
    observation and in that observation as a goal.

    Raises:
        CheckpointError: there is no encoder, or it is not of this store's environment.
        UsageError: `folder` was made with other settings, or the encoder does not tell where things are.
        StoreError: the store lacks simulator states, or the disk is full.
    """
    encoder, weights = _encoder(str(config.encoder)), config.encoder / "policy" / WEIGHTS
    note = {
        "store": store.name(),
        "encoder": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "every": config.every,
    }
    claim(folder, NOTE, note, "perceived")
    numbers = store.indices()
    jobs = [
        Job(
            key=int(number),
            function=perceive,
            kwargs={"source": store.name(), "encoder": str(config.encoder), "out": str(folder), "index": int(number)},
        )
        for number in numbers
        if not episode_path(folder, int(number)).exists()
    ]
    if not jobs:
        return
    environment = _environment(json.dumps(dict(store.spec.environment)))
    seen = environment.observe(encoder.cameras)
    encoder.check(environment.spec, {camera: (int(i.shape[0]), int(i.shape[1])) for camera, i in seen.images.items()})
    encoder.perceived(_inputs([seen]))
    done = len(numbers) - len(jobs)
    with (
        LocalExecutorConfig(workers=workers).build() as executor,
        Progress(f"perceived {folder}", len(numbers), "episode", done, executor.workers) as progress,
    ):
        for count, result in enumerate(executor.run(jobs), done + 1):
            progress.to(count, seconds=result.seconds)


def perceive(source: str, encoder: str, out: str, index: int) -> None:
    """Moments of the episode that was recorded under `index`, as the encoder perceives them: what a worker does."""
    store, policy, every = _store(source), _encoder(encoder), int(_load_note(out)["every"])
    environment = _environment(json.dumps(dict(store.spec.environment)))
    states = store.array(int(np.searchsorted(store.indices(), index)), "sim.state")
    t = np.unique([*range(every // 2, len(states), every), len(states) - 1])  # the last one is a goal of practice
    seen = []
    for state in states[t]:
        environment.set_state(np.array(state))
        seen.append(environment.observe(policy.cameras))
    observed, wanted = policy.perceived(_inputs(seen))
    write_tensors(
        episode_path(Path(out), index),
        {"t": t.astype(np.int64), "observed": observed[:, 0].numpy(), "wanted": wanted.numpy()},
        {"format": "perceived"},
    )


def _inputs(seen: Sequence[Observation]) -> Inputs:
    """Each observation with itself as its goal."""

    def stack(values: list[Array]) -> torch.Tensor:
        return torch.from_numpy(np.stack(values))

    state, achieved = stack([one.state for one in seen]), stack([one.achieved for one in seen])
    images = {camera: stack([one.images[camera] for one in seen]) for camera in seen[0].images}
    return Inputs(
        state=state[:, None],
        achieved=achieved[:, None],
        history_mask=torch.ones(len(seen), 1, dtype=torch.bool),
        goal_achieved=achieved,
        goal_proprio=state,
        images={camera: frames[:, None] for camera, frames in images.items()},
        goal_images=images,
    )


@functools.cache
def _store(path: str) -> Store:
    return open_store(path)


@functools.cache
def _load_note(folder: str) -> dict[str, Any]:
    note: dict[str, Any] = json.loads((Path(folder) / NOTE).read_text())
    return note


@functools.cache
def _encoder(run: str) -> Policy:
    if not Path(run).is_dir():
        raise CheckpointError(f"there is no run at {run} whose image encoder could be used")
    return Policy.load(Path(run) / "policy")


@functools.cache
def _environment(config: str) -> Environment:
    environment = from_dict(EnvironmentConfig, json.loads(config)).build()
    environment.reset(0)
    return environment
