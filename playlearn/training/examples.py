"""Rendered scenes as examples, held-out batches, and the check for cameras."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from playlearn.data import Batch, PlayDataset, Variation
from playlearn.errors import UsageError
from playlearn.scenes import Scenes
from playlearn.store import Store
from playlearn.training.config import TrainConfig


def check_cameras(config: TrainConfig, store: Store) -> None:
    """Raises UsageError where the store lacks a camera; the message says how to render it."""
    has = store.cameras()
    missing = [camera for camera in (*config.data.cameras, *config.data.goal_cameras) if camera not in has]
    if missing:
        missing = list(dict.fromkeys(missing))
        there = ", ".join(f"{camera} {h}x{w}" for camera, (h, w) in has.items()) or "none"
        wanted = " ".join(f"--camera {camera}=64x64" for camera in missing)
        rendered = f"`playlearn render {store.name()} OUT {wanted}` renders them from its simulator states"
        chosen = "name its own in `policy.encoder`"
        way = rendered if store.array(0, "sim.state").shape[1] else chosen
        raise UsageError(f"{store.name()} has no images of {', '.join(missing)} (it has: {there}); {way}")


def validation_batches(
    config: TrainConfig, store: Store, vary: Callable[[PlayDataset], Variation] | None = None
) -> list[Batch]:
    """Of held-out play, always the same; none where nothing is held out. vary: what makes variants of a dataset's."""
    if config.data.val_fraction <= 0 or config.val_batches <= 0:
        return []
    dataset: PlayDataset = config.data.build(store, "val", config.seed)
    dataset.vary = None if vary is None else vary(dataset)
    order = dataset.epoch_indices(0)[: config.val_batches * config.batch_size]
    return [dataset.batch(0, part) for part in _parts(order, config.batch_size)]


def rendered_scenes(config: TrainConfig, folder: Path, episodes: NDArray[np.int64], actions: int) -> Scenes:
    """The scenes in a folder that were rendered of these episodes (their numbers). actions: A."""
    encoder = config.policy.encoder
    return Scenes(
        folder,
        episodes,
        cameras=encoder.observation_cameras,
        goal_cameras=encoder.goal_cameras,
        labels=(config.policy.chunk, actions),
        seed=config.seed,
    )


def validation_scenes(config: TrainConfig, scenes: Scenes) -> list[Batch]:
    """The first so many of them, always the same."""
    order = scenes.epoch_indices(0)[: config.val_batches * config.batch_size]
    return [scenes.batch(part) for part in _parts(order, config.batch_size) if len(part)]


def _parts(order: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """As few parts, as equal, as hold at most `size` each."""
    return np.array_split(order, max(1, math.ceil(len(order) / size)))
