"""What a training run learns from: recorded play, and what is made of it before the first update."""

import functools
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from accelerate import Accelerator
from numpy.typing import NDArray

from playlearn.batch import Batch
from playlearn.data import (
    Augmentation,
    AugmentedDataset,
    Corrections,
    DatasetMixture,
    Part,
    Perceived,
    PlayDataset,
    Scenes,
    build_sources,
    mix_datasets,
)
from playlearn.data.split import val_mask
from playlearn.policies import Policy
from playlearn.store import Store
from playlearn.training.config import TrainConfig

_NAMED = 10  # episodes in a remark


class RunExamples:
    """The examples of a run, in order of time: as recorded, then with what `make` adds to them.

    data: the store's play, as recorded.
    val: held-out batches, always the same.
    """

    def __init__(self, config: TrainConfig, store: Store, out: Path, accelerator: Accelerator) -> None:
        self.config, self.store, self.out, self.accelerator = config, store, out, accelerator
        self.data: PlayDataset = config.data.build(store, "train", config.seed)
        self.val = validation_batches(config, store)
        self._sources = build_sources(self.data, config.extra_datasets, config.seed, blind=config.blind)
        self._own: Part = self.data  # what is shown of it
        self._extra: list[tuple[Part, float]] = [*self._sources]

    def cameras(self) -> Mapping[str, tuple[int, int]]:
        """Camera -> (height, width) of the images to learn from."""
        if self.config.scenes is None:
            return self.store.cameras()
        # Their makers bring the simulators along, here and below.
        from playlearn.collection.scenes import scene_sizes

        return {**self.store.cameras(), **scene_sizes(self.store, self.config.policy.encoder.observation_cameras)}

    def make(self, policy: Policy) -> None:
        """Make the corrections, scenes and estimates that the config asks for; what is there already stays.

        policy: the one that is trained.
        """
        self._make_corrections()
        self._render_scenes(len(policy.spec.action_names))
        self._perceive(policy)

    def mixed(self) -> Part | DatasetMixture:
        """All of them, each with its fraction."""
        return mix_datasets(self._own, self._extra)

    def _make_corrections(self) -> None:
        corrections = self.config.corrections
        if corrections is None:
            return
        from playlearn.collection.corrections import make_corrections

        folder = corrections.folder or self.out / "corrections"
        if self.accelerator.is_main_process:
            make_corrections(corrections, self.store, self.data.episodes, self.config.data.cameras, folder)
        self.accelerator.wait_for_everyone()
        self._own = AugmentedDataset(self.data, Corrections(folder, self.data, corrections.fraction))

    def _render_scenes(self, actions: int) -> None:
        config, scenes = self.config, self.config.scenes
        if scenes is None:
            return
        from playlearn.collection.scenes import render_scenes

        folder, held_out = scenes.folder or self.out / "scenes", val_mask(self.store, config.data.val_fraction)
        if self.accelerator.is_main_process:
            render_scenes(scenes, self.store, held_out, config.policy.encoder.observation_cameras, folder)
        self.accelerator.wait_for_everyone()
        numbers = self.store.indices()
        rendered = self._scenes(folder, numbers[~held_out], actions)
        if scenes.fraction < 1:
            self._extra = [(rendered, scenes.fraction), *self._extra]
            return
        self._own = rendered
        if held_out.any():
            of_val = self._scenes(folder, numbers[held_out], actions)
            order = of_val.epoch_indices(0)[: config.val_batches * config.batch_size]
            self.val = [of_val.batch(part) for part in _parts(order, config.batch_size) if len(part)]

    def _scenes(self, folder: Path, episodes: NDArray[np.int64], actions: int) -> Scenes:
        """The scenes in a folder that were rendered of these episodes (their numbers). actions: A."""
        policy = self.config.policy
        return Scenes(
            folder,
            episodes,
            cameras=policy.encoder.observation_cameras,
            goal_cameras=policy.encoder.goal_cameras,
            labels=(policy.chunk, actions),
            seed=self.config.seed,
        )

    def _perceive(self, policy: Policy) -> None:
        perceived = self.config.perceived
        if perceived is None:
            return
        from playlearn.collection.perceived import make_perceived

        run = perceived.encoder
        policy.behind(Policy.load(run / "policy"), run)  # raises where the two do not fit together
        folder = perceived.folder or self.out / "perceived"

        def augmented(dataset: PlayDataset, number: int) -> Part:
            if self.accelerator.is_main_process:
                make_perceived(perceived, dataset.store, folder / str(number))
            self.accelerator.wait_for_everyone()
            return AugmentedDataset(dataset, Perceived(folder / str(number), dataset))

        self._own = augmented(self.data, 0)
        self._extra = [(augmented(source, k), fraction) for k, (source, fraction) in enumerate(self._sources, 1)]
        self.val = validation_batches(self.config, self.store, functools.partial(Perceived, folder / "0"))


def store_remarks(config: TrainConfig, store: Store) -> list[str]:
    """What of the store is left out or called otherwise, and where goals come from if it records no objects."""
    settling = config.data.settling
    robot = settling.source != "achieved" or not store.spec.achieved_names
    goals = [settling.robot.describe(store.spec.state_names)] if robot else []
    return [*(f"{name}: {remark}" for name, remark in store.remarks().items()), *goals]


def unsettled_remarks(data: PlayDataset) -> list[str]:
    """Which episodes nothing settles in, where goals are settled moments: no example is cut from them."""
    table = data.table
    without = data.episodes[table.offsets[1:] == table.offsets[:-1]]
    if not len(without) or not data.config.goals.reads_moments:
        return []
    numbers = [str(number) for number in data.store.indices()[without][:_NAMED]]
    more = ", ..." if len(without) > _NAMED else ""
    return [f"{len(without)} of {len(data.episodes)} episodes have no settled moment: {', '.join(numbers)}{more}"]


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


def _parts(order: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """As few parts, as equal, as hold at most `size` each."""
    return np.array_split(order, max(1, math.ceil(len(order) / size)))
