"""Estimate moments of a store's episodes with an image encoder, on all cores; an interrupted call continues."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from playlearn.batch import Inputs
from playlearn.config import file_digest
from playlearn.data.perceived import PerceivedConfig
from playlearn.episode import Array, Observation
from playlearn.episode_jobs import made_of, make_files
from playlearn.errors import MissingRunError
from playlearn.executor import Job
from playlearn.policies import Policy
from playlearn.policies.policy import WEIGHTS
from playlearn.process_cache import cached_env_of, cached_note, cached_store
from playlearn.store import Store, episode_path
from playlearn.store.tensors import write_tensors

NOTE = "perceived.json"


def make_perceived(config: PerceivedConfig, store: Store, folder: Path, workers: int | None = None) -> None:
    """Leave in `folder` a file for each episode of the store; those that are there already stay.

    A file holds, of n moments: t (n,), and the encoder's estimates of `achieved`: observed (n, G) from the observation,
    wanted (n, G) from that observation as a goal.

    Raises:
        CheckpointError: there is no encoder, or it is not of this store's environment.
        UsageError: `folder` was made with other settings, or the encoder does not estimate where objects are.
        StoreError: the store lacks simulator states.
        BusyError: another process makes them.
        DiskError: the disk is full.
    """
    encoder, weights = _encoder(str(config.encoder)), config.encoder / "policy" / WEIGHTS
    note = {
        **made_of(store),
        "encoder": file_digest(weights),
        "every": config.every,
    }
    jobs = [
        Job(
            key=int(number),
            function=perceive,
            kwargs={"source": store.name(), "encoder": str(config.encoder), "out": str(folder), "index": int(number)},
        )
        for number in store.indices()
    ]

    def check() -> None:
        environment = cached_env_of(store)
        seen = environment.observe(encoder.cameras)
        sizes = {camera: (int(i.shape[0]), int(i.shape[1])) for camera, i in seen.images.items()}
        encoder.check(environment.spec, sizes)
        encoder.perceived(_inputs([seen]))

    make_files(folder, "perceived", note, jobs, workers, check)


def perceive(source: str, encoder: str, out: str, index: int) -> None:
    """Estimate moments of the episode that was recorded under `index`: one job."""
    store, policy = cached_store(source), _encoder(encoder)
    every = int(cached_note(str(Path(out) / NOTE))["every"])
    environment = cached_env_of(store)
    states = store.array(int(np.searchsorted(store.indices(), index)), "sim.state")
    t = np.unique([*range(every // 2, len(states), every), len(states) - 1])  # the last one is the goal of a rollout
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
def _encoder(run: str) -> Policy:
    if not Path(run).is_dir():
        raise MissingRunError(f"there is no run at {run} whose image encoder could be used")
    return Policy.load(Path(run) / "policy")
