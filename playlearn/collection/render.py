"""Draw images for play that was recorded without them, or with others."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from playlearn.collection.env import env
from playlearn.config import from_dict
from playlearn.errors import UsageError
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.report.progress import Progress
from playlearn.sim import CameraConfig, EnvironmentConfig
from playlearn.store import NativeStore, write_episode


def render_store(
    source: Path,
    out: Path,
    cameras: Mapping[str, CameraConfig],
    workers: int | None = None,
    episodes: int | None = None,
) -> None:
    """A store like `source` with images of these cameras and sizes, drawn from its simulator states.

    Goes on where an interrupted call stopped. episodes: the first so many only; a later call may ask for more.

    Raises:
        StoreError: `source` is missing, or `out` holds something else.
        UsageError: the environment has no such camera, or the store not so many episodes.
    """
    store = NativeStore.open(source)
    config = from_dict(EnvironmentConfig, store.spec.environment)
    known = config.build().spec.cameras
    unknown = sorted(set(cameras) - set(known))
    if unknown:
        raise UsageError(f"camera {unknown[0]!r} is not one of {', '.join(known)}")
    if episodes is not None and not 0 < episodes <= len(store):
        raise UsageError(f"episodes must be 1 to {len(store)}, as many as {source} has, got {episodes}")
    indices = store.indices()[:episodes]
    sizes = {name: (size.height, size.width) for name, size in cameras.items()}
    spec = dataclasses.replace(store.spec, cameras=sizes)
    made = NativeStore.open(out) if (out / "store.json").exists() else NativeStore.create(out, spec)
    made.spec.check(spec)
    with made.writer():
        done = set(made.indices().tolist())
        jobs = [
            Job(
                key=int(index),
                function=redraw,
                kwargs={"source": str(source), "out": str(out), "index": int(index), "sizes": sizes},
            )
            for index in indices
            if int(index) not in done
        ]
        with (
            LocalExecutorConfig(workers=workers).build() as executor,
            Progress(f"render {out}", len(indices), "episode", len(indices) - len(jobs), executor.workers) as progress,
        ):
            for count, result in enumerate(executor.run(jobs), len(indices) - len(jobs) + 1):
                progress.to(count, seconds=result.seconds)


def redraw(source: str, out: str, index: int, sizes: Mapping[str, Sequence[int]]) -> None:
    """Draw the episode that was recorded under `index` anew: what a worker does."""
    store = _store(source)
    position = int(np.searchsorted(store.indices(), index))  # by number: somebody may be adding to `source`
    environment = env(from_dict(EnvironmentConfig, dict(store.spec.environment)))
    states = store.array(position, "sim.state")
    images = {camera: np.empty((len(states), h, w, 3), np.uint8) for camera, (h, w) in sizes.items()}
    for t, state in enumerate(states):
        environment.set_state(np.array(state))
        for camera, (h, w) in sizes.items():
            images[camera][t] = environment.render(camera, h, w)
    episode = store.with_images(position, images, environment.renderer())
    write_episode(out, index, episode)


@functools.cache
def _store(path: str) -> NativeStore:
    return NativeStore.open(path)
