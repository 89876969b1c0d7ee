"""Recording play: by scripted players on all cores, by a person with a device, and its images drawn afterwards."""

from playlearn.collect.by_hand import collect_by_hand, record_by_hand
from playlearn.collect.config import CollectConfig, episode_seed
from playlearn.collect.job import collect, collect_one, play, record
from playlearn.collect.redraw import redraw, render_store

__all__ = [
    "CollectConfig",
    "collect",
    "collect_by_hand",
    "collect_one",
    "episode_seed",
    "play",
    "record",
    "record_by_hand",
    "redraw",
    "render_store",
]
