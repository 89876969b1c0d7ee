"""What LeRobot has no column for, one file an episode beside its metadata, so that a store comes back as it was.

    meta/playlearn/000007.safetensors    the 8th episode of the dataset: what was executed where it is not the label,
                                         simulator states, skills, time, the observation after the last action

LeRobot's own tools leave the folder behind when they write a dataset anew (split, merge); what they write is then read
as any other dataset.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from playlearn.episode import IMAGES, STORED, Array, Episode, EpisodeMeta
from playlearn.errors import StoreError
from playlearn.store.base import from_json, to_json
from playlearn.store.tensors import DAMAGED, Header, map_tensors, read_header, write_tensors

FOLDER = "meta/playlearn"
LAST = "last."
WHOLE = tuple(STORED[name] for name in ("sim_state", "time", "action", "skill", "intervention"))
SEEN = tuple(STORED[name] for name in ("state", "achieved"))


def keep(root: Path, entry: int, index: int, episode: Episode) -> None:
    """Write the rest of an episode that was recorded under `index` and is the dataset's episode `entry`."""
    arrays = episode.arrays()
    kept = {key: arrays[key] for key in WHOLE}
    kept |= {LAST + key: arrays[key][-1] for key in arrays if key in SEEN or key.startswith(IMAGES)}
    (root / FOLDER).mkdir(parents=True, exist_ok=True)
    write_tensors(_path(root, entry), kept, {"meta": to_json(episode.meta), "index": str(index)})


def is_kept(root: Path) -> bool:
    return (root / FOLDER).is_dir()


@dataclass
class Rest:
    """The rest of one episode; raises StoreError where its file is missing or broken."""

    path: Path

    @classmethod
    def of(cls, root: Path, entry: int) -> "Rest":
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
        except DAMAGED as error:
            raise StoreError(f"{self.path} cannot be read ({error}): fetch it again") from error

    def arrays(self) -> dict[str, Array]:
        """What `keep` wrote, mapped."""
        return map_tensors(self.path, self.header.layout)


def joined(rows: Array, kept: Mapping[str, Array], key: str) -> Array:
    """(T+1, ...): the T rows that LeRobot has of an observation, and the last."""
    return np.concatenate([rows, kept[LAST + key][None]])


def _path(root: Path, entry: int) -> Path:
    return root / FOLDER / f"{entry:06d}.safetensors"
