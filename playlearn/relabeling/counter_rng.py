"""Counter-based random numbers: hashes of where they are used, so that any worker computes the same ones."""

import numpy as np
from numpy.typing import NDArray

from playlearn.relabeling.index import Indices


def counter_uniforms(seed: int, epoch: int | Indices, indices: Indices, columns: int) -> NDArray[np.float64]:
    """(n, columns) independent numbers in [0, 1), each a hash of its own (seed, epoch, index, column).

    SplitMix64 (Steele, Lea and Flood, 2014) applied once for each of them.
    """
    hashed: NDArray[np.uint64] = np.full((len(indices), columns), seed & 0xFFFFFFFFFFFFFFFF, np.uint64)
    for part in (np.broadcast_to(epoch, indices.shape)[:, None], indices[:, None], np.arange(columns)[None]):
        hashed = _mix(hashed ^ (part.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)))
    return np.asarray((hashed >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def _mix(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
