"""The processors between LeRobot's batches and our policy: batch dimension and device only."""

from typing import Any

from lerobot.processor import make_default_pre_post_processors

from playlearn.lerobot.configuration_playlearn import PlaylearnConfig


def make_playlearn_pre_post_processors(config: PlaylearnConfig, dataset_stats: Any = None) -> tuple[Any, Any]:
    """LeRobot's default pipelines; the policy normalizes by itself."""
    made: tuple[Any, Any] = make_default_pre_post_processors(config, dataset_stats)
    return made
