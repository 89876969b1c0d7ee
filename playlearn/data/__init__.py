"""A store and a way of relabeling, turned into batches: one dataset, or several in one stream."""

from playlearn.data.augmented import Augmentation, AugmentedDataset, Recorded
from playlearn.data.cameras import check_cameras
from playlearn.data.corrections import Corrections, CorrectionsConfig
from playlearn.data.dataset import DataConfig, PlayDataset
from playlearn.data.finite import check_finite
from playlearn.data.mixture import DatasetMixture, DatasetSource, Part, build_sources, mix_datasets
from playlearn.data.perceived import Perceived, PerceivedConfig
from playlearn.data.scenes import Scenes, ScenesConfig
from playlearn.data.statistics import statistics
from playlearn.data.stream import Examples, Indices, laid_end_to_end

__all__ = [
    "Augmentation",
    "AugmentedDataset",
    "Corrections",
    "CorrectionsConfig",
    "DataConfig",
    "DatasetMixture",
    "DatasetSource",
    "Examples",
    "Indices",
    "Part",
    "Perceived",
    "PerceivedConfig",
    "PlayDataset",
    "Recorded",
    "Scenes",
    "ScenesConfig",
    "build_sources",
    "check_cameras",
    "check_finite",
    "laid_end_to_end",
    "mix_datasets",
    "statistics",
]
