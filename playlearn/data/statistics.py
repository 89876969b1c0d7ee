"""Mean and standard deviation of recorded play, for normalization."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from playlearn.batch import Statistics
from playlearn.data.dataset import PlayDataset
from playlearn.episode import Array
from playlearn.quantity import middle, nearest


def statistics(dataset: PlayDataset) -> dict[str, Statistics]:
    """Of `state`, `achieved` and `action` over every recorded row of the dataset's episodes.

    The std of a dimension that does not vary is 0, a figure like any other: whoever divides decides what to divide by.
    A change has mean 0 and the standard deviation of `achieved`: its own would be near 0 where changes are rare.
    """
    given = dataset.store.spec.quantities
    made = {
        "state": statistics_of(dataset.state, given.state),
        "achieved": statistics_of(dataset.achieved, given.achieved),
        "action": statistics_of(dataset.action),
    }
    if dataset.config.target == "next_settled_delta":
        made["action"] = dataclasses.replace(made["achieved"], mean=np.zeros_like(made["achieved"].mean))
    return made


def statistics_of(rows: Array, declared: Sequence[str] = ()) -> Statistics:
    """Of rows (n, D), an angle and a quaternion in the spelling nearest to their middle.

    declared: (D,) what each dimension measures; () where nobody said.
    """
    rows = nearest(rows, middle(rows, declared), declared)
    parts = rows.mean(axis=0, dtype=np.float64), rows.std(axis=0, dtype=np.float64)
    found = Statistics(*(np.asarray(part, np.float32) for part in parts))
    return dataclasses.replace(found, std=np.where(found.varies, found.std, np.float32(0)))
