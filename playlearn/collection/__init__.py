"""Recording play: by scripted players on all cores, by a person with a device, and its images drawn afterwards."""

from playlearn.collection.config import CollectConfig, episode_seed
from playlearn.collection.job import collect, collect_one, play, record
from playlearn.collection.render import redraw, render_store
from playlearn.collection.teleoperate import collect_by_hand, record_by_hand

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
