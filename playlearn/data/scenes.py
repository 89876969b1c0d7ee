"""Images that a simulator rendered of many scenes, as training examples without actions: for an image encoder.

The true state is privileged information: where each object is, and where in the image each camera sees it. They are
rendered by `playlearn.collection.scenes`; the same ones come in the same epoch for any number of workers.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from playlearn.batch import Batch
from playlearn.data.prefetch import prepared_ahead
from playlearn.data.stream import Indices, laid_end_to_end
from playlearn.episode import IMAGES, Array
from playlearn.errors import UsageError
from playlearn.store import episode_path
from playlearn.store.tensors import map_tensors, read_header

KEYPOINTS = "keypoints."  # before a camera's name: where it sees the objects
_OPEN = 1024  # files mapped at once
_SEED = 0x5CE4E5  # so that these orders are not those of the play


@dataclass(frozen=True)
class ScenesConfig:
    """Scenes that the simulator renders from a store's recorded states, with the true state: privileged information.

    per_episode: scenes of each episode, at random moments.
    rearranged: fraction of them whose objects are placed anew, as a random start of the environment places them. The
        robot stays as recorded; scenes of held-out episodes are never rearranged.
    fraction: of the training examples, how many are scenes; at 1 the store needs no images of its own.
    seed: of the moments and the rearrangements.
    folder: where they are kept, for several runs to use; null for the run's own.
    """

    per_episode: int = 120
    rearranged: float = 0.5
    fraction: float = 1.0
    seed: int = 0
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.per_episode < 1:
            raise UsageError(f"scenes.per_episode must be at least 1, got {self.per_episode}")
        if not 0 <= self.rearranged <= 1:
            raise UsageError(f"scenes.rearranged is a fraction, 0 to 1, got {self.rearranged}")
        if not 0 < self.fraction <= 1:
            raise UsageError(f"scenes.fraction must lie above 0 and at most at 1, got {self.fraction}")


class Scenes:
    """Scenes that `render_scenes` left in a folder, each its own goal: one image serves as observation and as goal.

    An example's actions are masked: only the image encoder learns from it.
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
        """numbers: of the episodes whose scenes are used. labels: H and A of the masked actions.

        Raises:
            StoreError: a file is missing or damaged.
        """
        self.cameras, self.goal_cameras, self.seed = cameras, goal_cameras, seed
        self._paths = [str(episode_path(folder, int(number))) for number in numbers]
        files = [_read(path) for path in self._paths]
        self._each = len(files[0]["observation.state"])
        self.state = np.concatenate([file["observation.state"] for file in files])  # (n, S)
        self.achieved = np.concatenate([file["achieved"] for file in files])  # (n, G)
        self._shape = labels

    def __len__(self) -> int:
        """n, observations."""
        return len(self.state)

    def epoch_indices(self, epoch: int) -> Indices:
        """(n,) the observations of an epoch in their order, each once."""
        return np.random.default_rng((self.seed, _SEED, epoch)).permutation(len(self))

    def batch(self, indices: Indices) -> Batch:
        """The given scenes."""
        files, rows = np.divmod(np.asarray(indices, np.int64), self._each)
        (steps, actions), count = self._shape, len(indices)

        def take(key: str) -> torch.Tensor:
            picked = [_read(self._paths[file])[key][row] for file, row in zip(files, rows, strict=True)]
            return torch.from_numpy(np.stack(picked))

        images = {camera: take(IMAGES + camera) for camera in self.cameras}
        keypoints = {camera: take(KEYPOINTS + camera) for camera in self.cameras}
        state, achieved = torch.from_numpy(self.state[indices]), torch.from_numpy(self.achieved[indices])
        return Batch(
            state=state[:, None],
            achieved=achieved[:, None],
            images={camera: frames[:, None] for camera, frames in images.items()},
            history_mask=torch.ones(count, 1, dtype=torch.bool),
            goal_achieved=achieved,
            goal_proprio=state,
            goal_images={camera: images[camera] for camera in self.goal_cameras},
            action=torch.zeros(count, steps, actions),
            action_mask=torch.zeros(count, steps, dtype=torch.bool),
            steps_to_goal=torch.zeros(count, dtype=torch.int64),
            keypoints={camera: points[:, None] for camera, points in keypoints.items()},
            goal_keypoints={camera: keypoints[camera] for camera in self.goal_cameras},
        )

    def at(self, places: Indices, orders: dict[int, Indices]) -> Batch:
        """See `PlayDataset.at`."""
        _, indices = laid_end_to_end(places, len(self), orders, self.epoch_indices)
        return self.batch(indices)

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
