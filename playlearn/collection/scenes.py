"""Render scenes of a store's episodes, on all cores; an interrupted call continues where it stopped."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from playlearn.data.scenes import KEYPOINTS, ScenesConfig
from playlearn.episode import IMAGES, Array
from playlearn.episode_jobs import made_of, make_files
from playlearn.errors import UsageError
from playlearn.executor import Job
from playlearn.layout import ObjectLayout
from playlearn.process_cache import cached_env_of, cached_note, cached_store
from playlearn.sim import Environment
from playlearn.store import Store, episode_path
from playlearn.store.tensors import write_tensors

NOTE = "scenes.json"


@runtime_checkable
class SceneEnvironment(Environment, Protocol):
    """An environment that can rearrange its objects around the robot, and whose cameras' geometry is known."""

    def rearrange(self, rng: np.random.Generator) -> None:
        """Place the objects as a random start does; the robot stays where it is. The state is only for rendering."""
        ...

    def project(self, camera: str, points: Array) -> Array:
        """(n, 3) m to (n, 2): where a camera sees them, x to the right and y down in [-1, 1]; NaN behind it."""
        ...


def render_scenes(
    config: ScenesConfig,
    store: Store,
    val_mask: NDArray[np.bool_],
    cameras: Sequence[str],
    folder: Path,
    workers: int | None = None,
) -> None:
    """Leave in `folder` a file for each episode of the store; those that are there already stay.

    A file holds, of n scenes: observation.state (n, S), achieved (n, G), images of `cameras` (n, h, w, 3) uint8, and
    under `keypoints.CAMERA` where that camera sees the objects of `ObjectLayout.places`, (n, O, 2) float32.

    val_mask: (N,) which episodes are held out.

    Raises:
        UsageError: `folder` was made with other settings, or the store's environment cannot be rearranged or rendered.
        StoreError: the store lacks simulator states.
        BusyError: another process makes them.
        DiskError: the disk is full.
    """
    note = {
        **made_of(store),
        "sizes": scene_sizes(store, cameras),
        **{name: getattr(config, name) for name in ("per_episode", "rearranged", "seed")},
    }
    jobs = [
        Job(
            key=int(number),
            function=render_scenes_of,
            kwargs={
                "source": store.name(),
                "out": str(folder),
                "index": int(number),
                "rearranged": 0.0 if held_out else config.rearranged,
            },
        )
        for number, held_out in zip(store.indices(), val_mask, strict=True)
    ]
    make_files(folder, "scenes", note, jobs, workers)


def scene_sizes(store: Store, cameras: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Camera -> (height, width) of what the store's environment renders.

    Raises:
        UsageError: it has no such camera, or cannot be rearranged.
    """
    environment = _environment(store)
    unknown = [camera for camera in cameras if camera not in environment.spec.cameras]
    if unknown:
        raise UsageError(f"scenes: there is no camera {unknown[0]!r}; there is {', '.join(environment.spec.cameras)}")
    images = environment.observe(tuple(dict.fromkeys(cameras))).images
    return {camera: (int(image.shape[0]), int(image.shape[1])) for camera, image in images.items()}


def render_scenes_of(source: str, out: str, index: int, rearranged: float) -> None:
    """Render scenes of the episode that was recorded under `index`: one job."""
    store, note = cached_store(source), cached_note(str(Path(out) / NOTE))
    environment = _environment(store)
    states = store.array(int(np.searchsorted(store.indices(), index)), "sim.state")
    rng = np.random.default_rng((int(note["seed"]), index))
    cameras, objects = tuple(note["sizes"]), ObjectLayout(environment.spec.achieved_names).places().values()
    rows: dict[str, list[Array]] = {}
    for t in rng.integers(len(states), size=int(note["per_episode"])):
        environment.set_state(np.array(states[t]))
        if rng.random() < rearranged:
            environment.rearrange(rng)
        scene = environment.observe(cameras)
        rows.setdefault("observation.state", []).append(scene.state)
        rows.setdefault("achieved", []).append(scene.achieved)
        points = np.array([scene.achieved[list(at)] for at in objects], np.float64).reshape(-1, 3)
        for camera in cameras:
            rows.setdefault(IMAGES + camera, []).append(scene.images[camera])
            rows.setdefault(KEYPOINTS + camera, []).append(environment.project(camera, points).astype(np.float32))
    write_tensors(
        episode_path(Path(out), index), {key: np.stack(values) for key, values in rows.items()}, {"format": "scenes"}
    )


def _environment(store: Store) -> SceneEnvironment:
    environment = cached_env_of(store)
    if not isinstance(environment, SceneEnvironment):
        raise UsageError(
            "scenes: this environment cannot rearrange its objects (`rearrange`, `project`); leave them out"
        )
    return environment
