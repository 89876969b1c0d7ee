"""A store and a way of relabeling, turned into batches: one dataset, or several in one stream."""

from playlearn.data.dataset import (
    DataConfig,
    Indices,
    PlayDataset,
    Recorded,
    Variation,
    laid_end_to_end,
    statistics,
)
from playlearn.data.mixture import DatasetMixture, DatasetSource, mix_datasets

__all__ = [
    "DataConfig",
    "DatasetMixture",
    "DatasetSource",
    "Indices",
    "PlayDataset",
    "Recorded",
    "Variation",
    "laid_end_to_end",
    "mix_datasets",
    "statistics",
]
