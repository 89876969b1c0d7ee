"""Drawn scenes as training examples without actions: the same ones in the same epoch for any number of workers."""

import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from playlearn.data import Batch, Indices
from playlearn.episode import IMAGES, Array
from playlearn.prefetch import prepared_ahead
from playlearn.relabel import counter_uniforms
from playlearn.scenes.draw import KEYPOINTS
from playlearn.store import episode_path
from playlearn.store.tensors import map_tensors, read_header

_OPEN = 1024  # files mapped at once
_SEED = 0x5CE4E5  # so that these draws are not those of the goals


class Scenes:
    """Scenes that `draw_scenes` left in a folder; any scene may be the goal of any other.

    An example's actions are masked: only what is learned of the images counts.
    """

    def __init__(
        self,
        folder: Path,
        numbers: NDArray[np.int64],
        *,
        cameras: tuple[str, ...],
        goal_cameras: tuple[str, ...],
        labels: tuple[int, int],
        seed: int,
    ) -> None:
        """numbers: of the episodes whose scenes are shown. labels: H and A of the masked actions.

        Raises:
            StoreError: a file is missing or damaged.
        """
        self.cameras, self.goal_cameras, self.seed = cameras, goal_cameras, seed
        self._paths = [str(episode_path(folder, int(number))) for number in numbers]
        files = [_read(path) for path in self._paths]
        self._each = len(files[0]["observation.state"])
        self.state = np.concatenate([file["observation.state"] for file in files])  # (n, S)
        self.achieved = np.stack([file["achieved"] for file in files])  # (files, 2 each, G)
        self._shape = labels

    def __len__(self) -> int:
        """n, observations."""
        return len(self.state)

    def epoch_indices(self, epoch: int) -> Indices:
        """(n,) the observations of an epoch in their order, each once."""
        return np.random.default_rng((self.seed, _SEED, epoch)).permutation(len(self))

    def batch(self, epoch: int | Indices, indices: Indices) -> Batch:
        """The given observations as they are in an epoch (one for all, or one each), each with a goal of any scene."""
        indices = np.asarray(indices, np.int64)
        file, row = np.divmod(indices, self._each)
        drawn = counter_uniforms(self.seed ^ _SEED, epoch, indices, 1)[:, 0]
        goal_file, goal_row = np.divmod((drawn * len(self)).astype(np.int64), self._each)
        goal_row += self._each
        steps, actions = self._shape
        count, ones = len(indices), torch.ones

        def take(key: str, files: Indices, rows: Indices) -> torch.Tensor:
            return torch.from_numpy(np.stack([_read(self._paths[f])[key][r] for f, r in zip(files, rows, strict=True)]))

        return Batch(
            state=torch.from_numpy(self.state[indices])[:, None],
            achieved=torch.from_numpy(self.achieved[file, row])[:, None],
            images={camera: take(IMAGES + camera, file, row)[:, None] for camera in self.cameras},
            history_mask=ones(count, 1, dtype=torch.bool),
            goal_achieved=torch.from_numpy(self.achieved[goal_file, goal_row]),
            goal_state=torch.from_numpy(self.state[indices]),
            goal_images={camera: take(IMAGES + camera, goal_file, goal_row) for camera in self.goal_cameras},
            action=torch.zeros(count, steps, actions),
            action_mask=torch.zeros(count, steps, dtype=torch.bool),
            steps_to_goal=torch.zeros(count, dtype=torch.int64),
            keypoints={camera: take(KEYPOINTS + camera, file, row)[:, None] for camera in self.cameras},
            goal_keypoints={camera: take(KEYPOINTS + camera, goal_file, goal_row) for camera in self.goal_cameras},
        )

    def at(self, places: Indices, orders: dict[int, Indices]) -> Batch:
        """See `PlayDataset.at`."""
        epochs = places // len(self)
        for epoch in set(orders) - set(epochs.tolist()):
            del orders[epoch]
        for epoch in set(epochs.tolist()) - set(orders):
            orders[epoch] = self.epoch_indices(epoch)
        indices = np.concatenate([orders[e][places[epochs == e] % len(self)] for e in np.unique(epochs).tolist()])
        return self.batch(epochs, indices)

    def batches(self, batch_size: int, start_step: int = 0, rank: int = 0, ranks: int = 1) -> Iterator[Batch]:
        """See `PlayDataset.batches`."""
        orders: dict[int, Indices] = {}

        def make(step: int) -> Batch:
            start = (step * ranks + rank) * batch_size
            return self.at(np.arange(start, start + batch_size), orders)

        return prepared_ahead(make, start_step)


@functools.lru_cache(maxsize=_OPEN)
def _read(path: str) -> dict[str, Array]:
    return map_tensors(Path(path), read_header(Path(path)).layout)
