"""What is said of a store before training, rendered scenes as examples, and held-out batches."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from playlearn.batch import Batch
from playlearn.data import Augmentation, AugmentedDataset, PlayDataset
from playlearn.scenes import Scenes
from playlearn.store import Store
from playlearn.training.config import TrainConfig


def store_remarks(config: TrainConfig, store: Store) -> list[str]:
    """What of the store is left out or called otherwise, and where goals come from if it records no objects."""
    settling = config.data.settling
    robot = settling.source == "robot" or not store.spec.achieved_names
    goals = [settling.robot.describe(store.spec.state_names)] if robot else []
    return [*(f"{name}: {remark}" for name, remark in store.remarks().items()), *goals]


def validation_batches(
    config: TrainConfig, store: Store, augment: Callable[[PlayDataset], Augmentation] | None = None
) -> list[Batch]:
    """Of held-out play, always the same; none where nothing is held out. augment: makes a dataset's augmentation."""
    if config.data.val_fraction <= 0 or config.val_batches <= 0:
        return []
    dataset: PlayDataset = config.data.build(store, "val", config.seed)
    examples = dataset if augment is None else AugmentedDataset(dataset, augment(dataset))
    order = examples.epoch_indices(0)[: config.val_batches * config.batch_size]
    return [examples.batch(0, part) for part in _parts(order, config.batch_size)]


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
