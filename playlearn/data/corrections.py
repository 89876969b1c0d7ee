"""Displaced moments of play with the way back as label, mixed into the recorded examples of a dataset.

They are made by `playlearn.collection.corrections`; the same ones come in the same epoch for any number of workers.
"""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from playlearn.batch import Batch
from playlearn.data.augmented import Recorded
from playlearn.data.dataset import PlayDataset
from playlearn.data.finite import check_finite
from playlearn.data.stream import Indices
from playlearn.episode import IMAGES, Array
from playlearn.errors import StoreError, UsageError
from playlearn.relabeling import counter_uniforms
from playlearn.store import episode_path
from playlearn.store.tensors import map_tensors, read_header

_OPEN = 256  # files mapped at once
_SEED = 0xC0FFEE  # so that these draws are not those of the goals


@dataclass(frozen=True)
class CorrectionsConfig:
    """Displaced moments of play.

    fraction: of the training examples, how many are corrected ones.
    displacement: of the end effector, meters at most.
    turn: of the end effector, radians at most.
    per_episode: displaced moments of each episode, fewer where the end effector is rarely free.
    steps: within how many the corrected labels lead back.
    seed: of the moments and displacements.
    folder: where they are kept, for several runs to use; null for the run's own.
    """

    fraction: float = 0.2
    displacement: float = 0.03
    turn: float = 0.2
    per_episode: int = 20
    steps: int = 8
    seed: int = 0
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where a number is out of range."""
        if not 0 < self.fraction <= 1:
            raise UsageError(f"corrections.fraction must lie above 0 and at most at 1, got {self.fraction}")
        for name in ("displacement", "turn"):
            if getattr(self, name) < 0:
                raise UsageError(f"corrections.{name} must not be below 0, got {getattr(self, name)}")
        for name in ("per_episode", "steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"corrections.{name} must be at least 1, got {getattr(self, name)}")


class Corrections:
    """The files that `make_corrections` left in a folder, as the augmentation of a dataset."""

    def __init__(self, folder: Path, dataset: PlayDataset, fraction: float) -> None:
        """fraction: see `CorrectionsConfig`. Only moments for which the dataset can draw a goal are used.

        Raises:
            StoreError: a file is missing, damaged or holds a number that is not finite, or there is no such moment.
        """
        self.folder, self.fraction, self.seed = folder, fraction, dataset.seed
        self.cameras = dataset.config.cameras
        numbers = dataset.store.indices()[dataset.episodes]
        files = [_read(str(episode_path(folder, int(number)))) for number in numbers]
        names = {"observation.state": dataset.store.spec.state_names, "action": dataset.store.spec.action_names}
        for number, own in zip(numbers, files, strict=True):
            for key, dimensions in names.items():
                check_finite(own[key], dimensions, f"{episode_path(folder, int(number))}, {key}")
        counts = [len(file["t"]) for file in files]
        file = np.repeat(np.arange(len(files)), counts)  # (m,)
        row = np.concatenate([np.arange(count) for count in counts])
        moment = np.concatenate([file_["t"] for file_ in files])
        example = _examples(dataset, dataset.episodes[file], moment)
        usable = example >= 0
        if not usable.any():
            raise StoreError(
                f"{folder} holds no displaced moment from which a goal can be drawn: take more per_episode"
            )
        self.numbers, self.file, self.row = numbers[file[usable]], file[usable], row[usable]
        self.example = example[usable]
        self.state = np.concatenate([one["observation.state"] for one in files])[usable]  # (m, S)
        self.action = np.concatenate([one["action"] for one in files])[usable]  # (m, k, A)
        self._cumulative = np.cumsum(dataset.probability(self.example))

    def __len__(self) -> int:
        """m, displaced moments."""
        return len(self.example)

    def __call__(self, recorded: Recorded, epoch: int | Indices, indices: Indices) -> Batch:
        """The batch of these examples, `fraction` of them replaced by corrected ones, drawn as `balance` weighs."""
        draws = counter_uniforms(self.seed ^ _SEED, epoch, indices, 2)
        chosen = np.flatnonzero(draws[:, 0] < self.fraction)  # (n,) places in the batch
        rows = np.searchsorted(self._cumulative, draws[chosen, 1] * self._cumulative[-1], side="right")
        rows = np.minimum(rows, len(self) - 1)
        indices = indices.copy()
        indices[chosen] = self.example[rows]
        return self._corrected(recorded(epoch, indices), chosen, rows)

    def _corrected(self, batch: Batch, places: Indices, rows: Indices) -> Batch:
        """`batch` with displaced observations and the way back in some rows; a displaced moment has no history."""
        steps = min(self.action.shape[1], batch.action.shape[1])
        state, action, mask = batch.state.clone(), batch.action.clone(), batch.history_mask.clone()
        achieved = batch.achieved.clone()
        state[places] = torch.from_numpy(self.state[rows])[:, None]
        achieved[places] = achieved[places][:, -1:]
        action[places, :steps] = torch.from_numpy(self.action[rows][:, :steps])
        mask[places, :-1] = False
        images = {camera: frames.clone() for camera, frames in batch.images.items()}
        for camera, frames in images.items():
            if len(rows):
                frames[places] = torch.from_numpy(self._images(camera, rows))[:, None]
        return dataclasses.replace(
            batch, state=state, achieved=achieved, action=action, history_mask=mask, images=images
        )

    def _images(self, camera: str, rows: Indices) -> Array:
        """(n, h, w, 3) uint8."""
        paths = [str(episode_path(self.folder, int(number))) for number in self.numbers[rows]]
        return np.stack([_read(path)[IMAGES + camera][row] for path, row in zip(paths, self.row[rows], strict=True)])


def _examples(dataset: PlayDataset, episodes: Indices, t: Sequence[int] | Indices) -> Indices:
    """(m,) the dataset's example at each (episode, t), -1 where there is none."""
    own_episode, own_t = dataset.where(np.arange(len(dataset)))
    longest = int(dataset.table.lengths.max()) + 1
    keys, wanted = own_episode * longest + own_t, episodes * longest + np.asarray(t)
    order = np.argsort(keys)
    found = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    return np.where(keys[order[found]] == wanted, order[found], -1)


@functools.lru_cache(maxsize=_OPEN)
def _read(path: str) -> dict[str, Array]:
    return map_tensors(Path(path), read_header(Path(path)).layout)
