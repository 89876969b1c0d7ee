"""Render images for play that was recorded without them, or with others."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from playlearn.config import RunFolder, atomic_write
from playlearn.episode_jobs import run_jobs
from playlearn.errors import UsageError
from playlearn.executor import Job
from playlearn.process_cache import cached_env_of, cached_store
from playlearn.sim import CameraConfig
from playlearn.store import NativeStore, with_images, write_episode

NOTE = "render.json"  # what the images were rendered of, beside store.json


def render_store(
    source: Path,
    out: Path,
    cameras: Mapping[str, CameraConfig],
    workers: int | None = None,
    episodes: int | None = None,
) -> None:
    """A store like `source` with images of these cameras and sizes, rendered from its simulator states.

    Continues an interrupted call. episodes: only the first so many; a later call may ask for more.

    Raises:
        StoreError: `source` is missing, or `out` holds something else.
        UsageError: the environment has no such camera, or the store not so many episodes; `out` was rendered of others.
        BusyError: another process writes into `out`.
        DiskError: the disk is full; the episodes that are done are kept.
    """
    store = NativeStore.open(source)
    known = cached_env_of(store).spec.cameras
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
        _claim(store, out)
        done = set(made.indices().tolist())
        jobs = [
            Job(
                key=int(index),
                function=render_episode,
                kwargs={"source": str(source), "out": str(out), "index": int(index), "sizes": sizes},
            )
            for index in indices
            if int(index) not in done
        ]
        run_jobs(f"render {out}", jobs, len(indices), workers)


def _claim(source: NativeStore, out: Path) -> None:
    """Record of which episodes `out` is made; more may come, but those that are there must be the same."""
    folder, episodes = RunFolder(out, NOTE, "rendered store", "name another OUT", entries=("episodes",)), {}
    if folder.file.is_file():
        episodes = json.loads(folder.file.read_text(encoding="utf-8"))["episodes"]
    note = {"episodes": source.digests()}
    folder.check_same({"episodes": episodes}, note)
    atomic_write(folder.file, json.dumps({"episodes": {**episodes, **note["episodes"]}}, indent=1).encode())


def render_episode(source: str, out: str, index: int, sizes: Mapping[str, Sequence[int]]) -> None:
    """Render the episode that was recorded under `index`: one job."""
    store = cached_store(source)
    position = int(np.searchsorted(store.indices(), index))  # by number: `source` may be growing
    environment = cached_env_of(store)
    states = store.array(position, "sim.state")
    images = {camera: np.empty((len(states), h, w, 3), np.uint8) for camera, (h, w) in sizes.items()}
    for t, state in enumerate(states):
        environment.set_state(np.array(state))
        for camera, (h, w) in sizes.items():
            images[camera][t] = environment.render(camera, h, w)
    episode = with_images(store.read(position), images, environment.renderer())
    write_episode(out, index, episode)
