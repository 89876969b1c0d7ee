"""Examples in batches without end: a pure function of (seed, step), whatever the number of workers or ranks."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from playlearn.batch import Batch
from playlearn.data.prefetch import prepared_ahead

Indices = NDArray[np.int64]


class Examples(ABC):
    """n examples an epoch, in an order that the epoch decides."""

    @abstractmethod
    def __len__(self) -> int:
        """n."""

    @abstractmethod
    def epoch_indices(self, epoch: int) -> Indices:
        """(n,) the examples of an epoch in their order."""

    @abstractmethod
    def batch(self, epoch: int | Indices, indices: Indices) -> Batch:
        """The given examples as they are in an epoch (one for all, or one each)."""

    def batches(self, batch_size: int, start_step: int = 0, rank: int = 0, ranks: int = 1) -> Iterator[Batch]:
        """Batches without end, prepared one ahead in a thread.

        Step s of rank r takes places (s * ranks + r) * batch_size onwards of all epochs laid end to end,
        so that a resumed run goes on exactly where it stopped. Close the iterator to end the thread.
        """
        orders: dict[int, Indices] = {}

        def make(step: int) -> Batch:
            start = (step * ranks + rank) * batch_size
            return self.at(np.arange(start, start + batch_size), orders)

        return prepared_ahead(make, start_step)

    def at(self, places: Indices, orders: dict[int, Indices]) -> Batch:
        """The batch at ascending places of all epochs laid end to end; `orders` keeps the current ones."""
        epochs, indices = laid_end_to_end(places, len(self), orders, self.epoch_indices)
        return self.batch(epochs, indices)


def laid_end_to_end(
    places: Indices, size: int, orders: dict[int, Indices], order: Callable[[int], Indices]
) -> tuple[Indices, Indices]:
    """The epoch, and the index in it, of ascending places of all epochs of `size` examples laid end to end.

    order: epoch -> (size,) its indices in their order; `orders` keeps those of the current epochs.
    """
    epochs = places // size
    current = np.unique(epochs).tolist()
    for epoch in set(orders) - set(current):
        del orders[epoch]
    for epoch in set(current) - set(orders):
        orders[epoch] = order(epoch)
    return epochs, np.concatenate([orders[epoch][places[epochs == epoch] % size] for epoch in current])
