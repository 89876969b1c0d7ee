"""Recording play: by a scripted play policy on all cores or by a person with a device; rendering its images later.

What is made of recorded play in a simulator, for `data` to read: `corrections`, `scenes`, `perceived`.
"""

from playlearn.collection.config import CollectConfig, episode_seed
from playlearn.collection.job import collect, collect_one, play, record
from playlearn.collection.render import render_episode, render_store
from playlearn.collection.teleoperate import collect_by_teleoperation, record_teleoperation

__all__ = [
    "CollectConfig",
    "collect",
    "collect_by_teleoperation",
    "collect_one",
    "episode_seed",
    "play",
    "record",
    "record_teleoperation",
    "render_episode",
    "render_store",
]
