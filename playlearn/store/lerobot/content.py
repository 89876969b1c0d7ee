"""The columns of a LeRobot dataset, one row a frame, made from a store of play.

    observation.state               (S,)        observation.images.<camera>   (h, w, 3)
    observation.environment_state   (G,)        achieved: objects and fixtures
    action                          (A,)        the label, `expert_action`
    intervention                    (1,) bool   an expert took over (LeRobot's own name for it)
    next.success                    (1,) bool   only where it is known of every episode
    next.reward                     (1,)        only where every episode has recorded rewards
    task                            text        the episode's task; for play, the skill at that step; the recorder's
                                                own words unchanged

Skills can stand as LeRobot's subtask annotation instead, `language_persistent`; the task of play is then "play". That
is optional: LeRobot's own viewer (0.6.1) and PyTorch's default collate cannot take such a column.

An episode of T actions becomes T frames: LeRobot has no place for the observation after the last action. It and
whatever else it has no column for are written to sidecar files, see `sidecar.py`. What others recorded with an action
at its last observation (`EpisodeMeta.unobserved_step`) has the T + 1 frames that it had.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Protocol

import numpy as np

from playlearn.episode import IMAGES, Array, Episode
from playlearn.quantity import Quantities
from playlearn.store.base import Store, StoreSpec
from playlearn.store.lerobot.metadata import BOUNDS, QUANTITIES

PLAY = "play"  # task of a step that has neither a task nor a skill
STATE, ACHIEVED, ACTION = "observation.state", "observation.environment_state", "action"
INTERVENTION, SUCCESS, NEXT_REWARD = "intervention", "next.success", "next.reward"

type Features = dict[str, dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Entry:
    """One LeRobot episode of T frames, here the number of its rows.

    columns: key -> (T, ...).
    tasks: T names.
    subtasks: (first frame, name), empty unless annotated.
    sidecar: (number it was recorded under, the recording), for the sidecar file; None for a part of a recording.
    """

    columns: Mapping[str, Array]
    tasks: tuple[str, ...]
    subtasks: tuple[tuple[int, str], ...] = ()
    sidecar: tuple[int, Episode] | None = None

    def __len__(self) -> int:
        return len(self.columns[ACTION])


class Content(Protocol):
    """The episodes of a dataset, made one at a time."""

    @property
    def store(self) -> Store:
        """The store that they are made from."""
        ...

    def __len__(self) -> int: ...

    def features(self) -> Features:
        """LeRobot's description of each column; cameras as images."""
        ...

    def entry(self, i: int) -> Entry: ...


@dataclass
class Play:
    """A store as it is: one entry an episode.

    store: the play.
    annotated: write skills as subtasks.
    has_success: whether success is known of every episode.
    has_reward: whether every episode has recorded rewards.
    """

    store: Store
    annotated: bool = False
    has_success: bool = field(init=False)
    has_reward: bool = field(init=False)

    def __post_init__(self) -> None:
        every = range(len(self.store))
        self.has_success = bool(every) and all(self.store.meta(i).success is not None for i in every)
        self.has_reward = bool(every) and all(self.store.rewards(i) is not None for i in every)

    def __len__(self) -> int:
        return len(self.store)

    def features(self) -> Features:
        spec = self.store.spec
        given = spec.quantities
        made = vectors({STATE: spec.state_names, ACHIEVED: spec.achieved_names, ACTION: spec.action_names})
        made = declared(made, {STATE: given.state, ACHIEVED: given.achieved}, given)
        made |= flags(INTERVENTION, *([SUCCESS] if self.has_success else []))
        made |= {NEXT_REWARD: {"dtype": "float32", "shape": (1,), "names": None}} if self.has_reward else {}
        return made | image_features(self.store.cameras())

    def entry(self, i: int) -> Entry:
        episode = self.store.read(i)
        after = episode.meta.unobserved_step
        rows = len(episode) + bool(after)
        success = np.zeros((rows, 1), np.bool_)
        success[-1] = episode.meta.success
        columns = steps(episode, 0, rows) | ({SUCCESS: success} if self.has_success else {})
        if self.has_reward and episode.reward is not None:
            rewards = np.append(episode.reward, after.get("reward", []))
            columns[NEXT_REWARD] = rewards[:, None].astype(np.float32)
        sidecar = int(self.store.indices()[i]), episode
        annotation = subtasks(episode, 0, len(episode)) if self.annotated else ()
        own = tasks(episode, annotated=self.annotated)
        return Entry(columns, own + own[-1:] * bool(after), annotation, sidecar)


def steps(episode: Episode, begin: int, end: int) -> dict[str, Array]:
    """The columns of steps begin ... end-1 that every dataset has; an unobserved step is the last one."""
    action, intervention = episode.expert_action, episode.intervention
    if episode.meta.unobserved_step:
        action = np.append(action, np.array([episode.meta.unobserved_step["action"]], np.float32), axis=0)
        intervention = np.append(intervention, False)
    columns = {
        STATE: episode.state[begin:end],
        ACHIEVED: episode.achieved[begin:end],
        ACTION: action[begin:end],
        INTERVENTION: intervention[begin:end, None],
        **{IMAGES + camera: frames[begin:end] for camera, frames in episode.images.items()},
    }
    return {key: column for key, column in columns.items() if column.shape[1]}  # LeRobot cannot write an empty column


def subtasks(episode: Episode, begin: int, end: int) -> tuple[tuple[int, str], ...]:
    """The skills of steps begin ... end-1, each with its first frame (counted from `begin`)."""
    at, found = 0, []
    for skill, run in groupby(skill_names(episode)[begin:end]):
        found += [(at, skill)] if skill else []
        at += len(list(run))
    return tuple(found)


def tasks(episode: Episode, *, annotated: bool) -> tuple[str, ...]:
    """(T,) the task at each step.

    annotated: whether skills stand elsewhere. The recorder's own words are tasks all the same.
    """
    meta = episode.meta
    if meta.verbatim:
        return tuple(skill_names(episode)) if meta.skills else (meta.task,) * len(episode)
    skills = [PLAY] * len(episode) if annotated else skill_names(episode)
    return tuple(meta.task or skill or PLAY for skill in skills)


def skill_names(episode: Episode) -> list[str]:
    """(T,) the skill at each step, "" for none: our own as words, the recorder's as they are."""
    found = [name for name, _ in episode.meta.annotations()]
    names = found if episode.meta.verbatim else [name.replace("_", " ") for name in found]
    return [names[skill] for skill in episode.skill]


def robot(spec: StoreSpec) -> str:
    """LeRobot's `robot_type`."""
    return str(spec.environment.get("robot", spec.environment.get("type", "unknown")))


def vectors(named: Mapping[str, tuple[str, ...]]) -> Features:
    """Features of named numbers; an empty one is left out."""
    return {
        k: {"dtype": "float32", "shape": (len(names),), "names": list(names)} for k, names in named.items() if names
    }


def declared(features: Features, quantities: Mapping[str, tuple[str, ...]], given: Quantities) -> Features:
    """The same with what their numbers measure and what bounds the actions, which LeRobot keeps and does not read."""
    added: dict[str, dict[str, Any]] = {key: {QUANTITIES: list(own)} for key, own in quantities.items() if own}
    if given.action_bounds:
        added[ACTION] = {BOUNDS: [pair and list(pair) for pair in given.action_bounds]}
    return {key: {**feature, **added.get(key, {})} for key, feature in features.items()}


def flags(*keys: str) -> Features:
    return {key: {"dtype": "bool", "shape": (1,), "names": None} for key in keys}


def image_features(cameras: Mapping[str, tuple[int, int]]) -> Features:
    """Features of cameras, name -> (height, width)."""
    names = ["height", "width", "channels"]
    return {IMAGES + key: {"dtype": "image", "shape": (h, w, 3), "names": names} for key, (h, w) in cameras.items()}
