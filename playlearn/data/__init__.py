"""A store and a way of relabeling, turned into batches: one dataset, or several in one stream."""

from playlearn.data.augmented import Augmentation, AugmentedDataset, Recorded
from playlearn.data.cameras import check_cameras
from playlearn.data.dataset import DataConfig, PlayDataset
from playlearn.data.mixture import DatasetMixture, DatasetSource, Part, build_sources, mix_datasets
from playlearn.data.statistics import statistics
from playlearn.data.stream import Examples, Indices, laid_end_to_end

__all__ = [
    "Augmentation",
    "AugmentedDataset",
    "DataConfig",
    "DatasetMixture",
    "DatasetSource",
    "Examples",
    "Indices",
    "Part",
    "PlayDataset",
    "Recorded",
    "build_sources",
    "check_cameras",
    "laid_end_to_end",
    "mix_datasets",
    "statistics",
]
