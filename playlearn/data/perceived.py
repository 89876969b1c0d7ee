"""Play as an image encoder perceives it: a state policy that is to act behind that encoder learns from it.

A policy that learned from true states acts on every difference between the current state and the goal. An encoder's
estimates always differ a little, and by a lot for what is hidden, so behind an encoder such a policy moves the wrong
object, or waits. The encoder's errors at some moments of each episode, rendered by the simulator, are applied to the
moments around them and added to the recorded states; the labels stay those of the true state. The estimates are made
by `playlearn.collection.perceived`.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from playlearn.batch import Batch
from playlearn.data.augmented import Recorded
from playlearn.data.dataset import PlayDataset
from playlearn.data.finite import check_finite
from playlearn.data.stream import Indices
from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.store import episode_path
from playlearn.store.tensors import map_tensors, read_header


@dataclass(frozen=True)
class PerceivedConfig:
    """Play as an image encoder perceives it.

    encoder: a run whose image encoder estimates where objects are, in observations and goal images.
    every: steps between two moments that are estimated; the errors there are applied to the moments around them.
    folder: where the estimates are kept, for several runs to use; null for the run's own.
    """

    encoder: Path
    every: int = 8
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if self.every < 1:
            raise UsageError(f"perceived.every must be at least 1, got {self.every}")


class Perceived:
    """What `make_perceived` left in a folder, as the augmentation of a dataset."""

    def __init__(self, folder: Path, dataset: PlayDataset) -> None:
        """Raises StoreError: a file is missing or damaged, or holds a number that is not finite."""
        errors: dict[str, list[Array]] = {"observed": [], "wanted": []}
        for position in dataset.episodes.tolist():
            true = dataset.store.array(position, "achieved")  # (T+1, G)
            path = episode_path(folder, int(dataset.store.indices()[position]))
            file = map_tensors(path, read_header(path).layout)
            near = nearest(np.asarray(file["t"]), len(true))
            for name, made in errors.items():
                check_finite(file[name], dataset.store.spec.achieved_names, f"{path}, {name}")
                made.append((file[name] - true[file["t"]])[near])
        self.dataset = dataset
        self.observed, self.wanted = map(np.concatenate, errors.values())  # (sum T+1, G), rows as in the dataset

    def __call__(self, recorded: Recorded, epoch: int | Indices, indices: Indices) -> Batch:
        """The batch of these examples, with `achieved` and the goal's as the encoder perceives them."""
        batch, dataset = recorded(epoch, indices), self.dataset
        episodes, t = dataset.where(indices)
        first = dataset.table.rows[np.searchsorted(dataset.episodes, episodes)]
        seen = np.maximum(t[:, None] + np.arange(1 - batch.achieved.shape[1], 1), 0)  # (B, T)
        observed = self.observed[first[:, None] + seen]
        wanted = self.wanted[first + dataset.goals(epoch, indices)]
        return dataclasses.replace(
            batch,
            achieved=batch.achieved + torch.from_numpy(observed),
            goal_achieved=batch.goal_achieved + torch.from_numpy(wanted),
        )


def nearest(moments: Indices, length: int) -> Indices:
    """(length,) which of the ascending moments lies nearest each of 0 ... length-1."""
    between = (moments[1:] + moments[:-1] + 1) // 2
    return np.searchsorted(between, np.arange(length), side="right")
