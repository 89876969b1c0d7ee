"""Sidecar files: what LeRobot has no column for, one file an episode, so that a store reads back as it was.

    meta/playlearn/000007.safetensors    the 8th episode of the dataset: what was executed where it is not the label,
                                         simulator states, skills, time, the observation after the last action (not
                                         where an unobserved step made a frame of it)

LeRobot's own tools leave the folder behind when they write a dataset anew (split, merge); what they write is then read
as any other dataset.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from playlearn.episode import IMAGES, REWARD, STORED, Array, Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.store.base import from_json, to_json
from playlearn.store.tensors import DAMAGED, Header, map_tensors, read_header, write_tensors

FOLDER = "meta/playlearn"
LAST = "last."
COPIED = tuple(STORED[name] for name in ("sim_state", "time", "action", "skill", "intervention"))
OBSERVED = tuple(STORED[name] for name in ("state", "achieved"))


def write(root: Path, entry: int, index: int, episode: Episode) -> None:
    """Write the sidecar of an episode that was recorded under `index` and is the dataset's episode `entry`."""
    arrays = episode.arrays()
    copied = {key: arrays[key] for key in (*COPIED, REWARD) if key in arrays}
    if not episode.meta.unobserved_step:
        copied |= {LAST + key: arrays[key][-1] for key in arrays if key in OBSERVED or key.startswith(IMAGES)}
    (root / FOLDER).mkdir(parents=True, exist_ok=True)
    write_tensors(_path(root, entry), copied, {"meta": to_json(episode.meta), "index": str(index)})


def exists(root: Path) -> bool:
    return (root / FOLDER).is_dir()


@dataclass
class Sidecar:
    """The sidecar of one episode; raises StoreError if its file is missing or broken."""

    path: Path

    @classmethod
    def of(cls, root: Path, entry: int) -> "Sidecar":
        return cls(_path(root, entry))

    @cached_property
    def header(self) -> Header:
        return read_header(self.path)

    @property
    def index(self) -> int:
        return int(self.header.metadata["index"])

    @property
    def steps(self) -> int:
        return self.header.layout.slots["action"].shape[0]

    @cached_property
    def meta(self) -> EpisodeMeta:
        try:
            return from_json(EpisodeMeta, self.header.metadata["meta"])
        except StoreError as error:
            raise StoreError(f"{self.path}: {error}") from error
        except DAMAGED as error:
            raise StoreError(f"{self.path} cannot be read ({error}): fetch it again") from error

    def arrays(self) -> dict[str, Array]:
        """What `write` wrote, memory-mapped."""
        return map_tensors(self.path, self.header.layout)


def joined(rows: Array, arrays: Mapping[str, Array], key: str) -> Array:
    """(T+1, ...): the rows of an observation that LeRobot has, and the last one where it is not among them."""
    return np.concatenate([rows, arrays[LAST + key][None]]) if LAST + key in arrays else rows


def _path(root: Path, entry: int) -> Path:
    return root / FOLDER / f"{entry:06d}.safetensors"
