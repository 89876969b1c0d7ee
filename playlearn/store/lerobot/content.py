"""What goes into a LeRobot dataset: columns, one row a frame, as they come from a store of play.

    observation.state               (S,)        observation.images.<camera>   (h, w, 3)
    observation.environment_state   (G,)        achieved: objects and fixtures
    action                          (A,)        the label, `expert_action`
    intervention                    (1,) bool   an expert took over (LeRobot's own name for it)
    next.success                    (1,) bool   only where every episode had a task, so that success is known
    task                            text        the episode's task; of play, the skill at that step in words

Skills can stand as LeRobot's subtask annotation instead, `language_persistent`; the task of play is then "play". That
is for who asks for it: LeRobot's own viewer (0.6.1) and PyTorch's default collate cannot take such a column.

An episode of T actions becomes T frames: LeRobot has no place for the observation after the last action. That one and
whatever else it has no column for stand beside, see `rest.py`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Protocol

import numpy as np

from playlearn.episode import IMAGES, Array, Episode, read_annotation
from playlearn.store.base import Store, StoreSpec

PLAY = "play"  # the task of a step that has neither a task nor a skill
REACHED = "stopped"  # how an episode with a task ends that reached it
STATE, ACHIEVED, ACTION = "observation.state", "observation.environment_state", "action"
INTERVENTION, SUCCESS = "intervention", "next.success"

type Features = dict[str, dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Entry:
    """One LeRobot episode of T frames.

    columns: key -> (T, ...). tasks: T. subtasks: (frame at which it begins, words), empty where nobody asked. rest:
    the recording itself, to be kept beside with the number it was recorded under; None where this is a part of one.
    """

    columns: Mapping[str, Array]
    tasks: tuple[str, ...]
    subtasks: tuple[tuple[int, str], ...] = ()
    sidecar: tuple[int, Episode] | None = None

    def __len__(self) -> int:
        return len(self.columns[ACTION])


class Content(Protocol):
    """The entries of a dataset, made one at a time."""

    @property
    def store(self) -> Store:
        """Where they come from."""
        ...

    def __len__(self) -> int: ...

    def features(self) -> Features:
        """LeRobot's description of each column; cameras as images."""
        ...

    def entry(self, i: int) -> Entry: ...


@dataclass
class Play:
    """A store as it is: one entry an episode. annotated: with skills as subtasks."""

    store: Store
    annotated: bool = False
    knows: bool = field(init=False)

    def __post_init__(self) -> None:
        self.knows = len(self.store) > 0 and all(self.store.meta(i).task for i in range(len(self.store)))

    def __len__(self) -> int:
        return len(self.store)

    def features(self) -> Features:
        spec = self.store.spec
        made = vectors({STATE: spec.state_names, ACHIEVED: spec.achieved_names, ACTION: spec.action_names})
        made |= flags(INTERVENTION, *([SUCCESS] if self.knows else []))
        return made | pictures(self.store.cameras())

    def entry(self, i: int) -> Entry:
        episode = self.store.read(i)
        reached = np.zeros((len(episode), 1), np.bool_)
        reached[-1] = episode.meta.ended == REACHED
        columns = steps(episode, 0, len(episode)) | ({SUCCESS: reached} if self.knows else {})
        sidecar = int(self.store.indices()[i]), episode
        spoken = subtasks(episode, 0, len(episode)) if self.annotated else ()
        skills = [PLAY] * len(episode) if self.annotated else words(episode)
        return Entry(columns, tuple(episode.meta.task or skill or PLAY for skill in skills), spoken, sidecar)


def steps(episode: Episode, begin: int, end: int) -> dict[str, Array]:
    """The columns that steps begin ... end-1 have in any dataset."""
    columns = {
        STATE: episode.state[begin:end],
        ACHIEVED: episode.achieved[begin:end],
        ACTION: episode.expert_action[begin:end],
        INTERVENTION: episode.intervention[begin:end, None],
        **{IMAGES + camera: frames[begin:end] for camera, frames in episode.images.items()},
    }
    return {key: column for key, column in columns.items() if column.shape[1]}  # nobody can write a column of nothing


def subtasks(episode: Episode, begin: int, end: int) -> tuple[tuple[int, str], ...]:
    """The skills within, in words, each with the frame (counted from `begin`) at which it begins."""
    at, found = 0, []
    for skill, run in groupby(words(episode)[begin:end]):
        found += [(at, skill)] if skill else []
        at += len(list(run))
    return tuple(found)


def words(episode: Episode) -> list[str]:
    """(T,) the skill at each step, "" for none."""
    names = [read_annotation(text)[0].replace("_", " ") for text in episode.meta.skills] or [""]
    return [names[skill] for skill in episode.skill]


def robot(spec: StoreSpec) -> str:
    """LeRobot's `robot_type`."""
    return str(spec.environment.get("robot", spec.environment.get("type", "unknown")))


def vectors(named: Mapping[str, tuple[str, ...]]) -> Features:
    """Of numbers with names; what has none is left out."""
    return {
        k: {"dtype": "float32", "shape": (len(names),), "names": list(names)} for k, names in named.items() if names
    }


def flags(*keys: str) -> Features:
    return {key: {"dtype": "bool", "shape": (1,), "names": None} for key in keys}


def pictures(cameras: Mapping[str, tuple[int, int]]) -> Features:
    """Of cameras, name -> (height, width)."""
    names = ["height", "width", "channels"]
    return {IMAGES + key: {"dtype": "image", "shape": (h, w, 3), "names": names} for key, (h, w) in cameras.items()}
