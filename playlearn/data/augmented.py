"""A dataset some of whose examples are replaced or changed: by corrections, by what an image encoder perceives."""

from collections.abc import Callable

import numpy as np

from playlearn.batch import Batch
from playlearn.data.stream import Examples, Indices

type Recorded = Callable[[int | Indices, Indices], Batch]  # (epoch, examples), as `Examples.batch`
type Augmentation = Callable[[Recorded, int | Indices, Indices], Batch]


class AugmentedDataset(Examples):
    """The examples of a dataset, in the same order, as an augmentation makes them.

    dataset: gives the recorded examples.
    augmentation: called with what gives recorded examples, the epoch and the examples that are asked for.
    """

    def __init__(self, dataset: Examples, augmentation: Augmentation) -> None:
        self._dataset, self._augmentation = dataset, augmentation

    def __len__(self) -> int:
        return len(self._dataset)

    def epoch_indices(self, epoch: int) -> Indices:
        return self._dataset.epoch_indices(epoch)

    def batch(self, epoch: int | Indices, indices: Indices) -> Batch:
        return self._augmentation(self._dataset.batch, epoch, np.asarray(indices, np.int64))
