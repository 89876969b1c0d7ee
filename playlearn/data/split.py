"""Which episodes of a store are never trained on."""

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling import counter_uniforms
from playlearn.store import Store


def val_mask(store: Store, fraction: float) -> NDArray[np.bool_]:
    """(N,) which episodes of a store are held out: as their metadata fixes it, else by their numbers."""
    by_number = val_episodes(store.indices(), fraction)
    if fraction <= 0:
        return by_number
    recorded = np.array([store.meta(i).split for i in range(len(store))], np.str_)
    return np.asarray(np.where(recorded == "", by_number, recorded == "val"), np.bool_)


def val_episodes(indices: NDArray[np.int64], fraction: float) -> NDArray[np.bool_]:
    """(N,) which episodes are held out, by the numbers they were recorded under.

    Of every 1 / fraction consecutive numbers one is held out, in the first such block number 0, so that more play never
    moves an episode from one split to the other.
    """
    if fraction <= 0:
        return np.zeros(len(indices), np.bool_)
    block = max(1, round(1 / fraction))
    drawn = (counter_uniforms(0, 0, indices // block, 1)[:, 0] * block).astype(np.int64)
    return np.asarray(indices % block == np.where(indices < block, 0, drawn))
