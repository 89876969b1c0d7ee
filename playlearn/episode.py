"""One recording of play, frozen and validated when built.

    observation  o_0 --a_0--> o_1 --a_1--> o_2  ...  --a_{T-1}--> o_T
    index         0            1            2                      T

`action[t]` was executed between observation t and t + 1, so there are T actions and T + 1
observations, achieved goals and simulator states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from playlearn.errors import EpisodeError
from playlearn.quantity import Quantities

Array = NDArray[Any]
IMAGES = "observation.images."
REWARD = "reward"


@dataclass(frozen=True, eq=False)
class Observation:
    """What can be seen at one moment.

    state: (S,) float32, the robot's own state (proprioception).
    achieved: (G,) float32, objects and fixtures: what a goal covers.
    images: camera -> (h, w, 3) uint8, upright; empty where no camera was asked for.
    time: simulated seconds.
    """

    state: Array
    achieved: Array
    images: Mapping[str, Array] = field(default_factory=dict)
    time: float = 0.0


@dataclass(frozen=True, eq=False)
class Goal:
    """What is to be reached; a policy reads what its encoder was built for, a scripted expert `achieved`.

    achieved: (G,) float32, objects and fixtures.
    images: camera -> (h, w, 3) uint8.
    state: (S,) float32, the robot's own state; None where the goal leaves it open.
    """

    achieved: Array
    images: Mapping[str, Array] = field(default_factory=dict)
    state: Array | None = None


@dataclass(frozen=True, eq=False)
class Decision:
    """What an actor decided for one environment at one step.

    action: (A,) in [-1, 1], executed.
    label: (A,), what a learner should copy (None: the action).
    skill: an annotation for analysis (see `annotation`).
    intervention: whether an expert took over here.
    """

    action: Array
    label: Array | None = None
    skill: str = ""
    intervention: bool = False


@dataclass(frozen=True)
class EpisodeMeta:
    """Where an episode comes from; everything in it is JSON.

    environment: `{"type": kind, ...}`, the environment's full config, enough to build it again.
    state_names: what each dimension of `state` is.
    achieved_names: what each dimension of `achieved` is (see ObjectLayout).
    action_names: what each dimension of `action` is.
    fps: steps a second.
    seed: of the episode.
    actor: who acted.
    skills: what `skill` indexes: annotations (see `annotation`), unless they are `verbatim`.
    controller: the controller's settings.
    cameras: name -> {"height", "width"} of the recorded images.
    renderer: GL back end and device.
    versions: package -> version.
    ended: why the episode stopped.
    task: what was asked for; "" in free play.
    split: "train" or "val" where the recording fixes it; "" leaves it to the episode's number.
    verbatim: `skills` are the recorder's own words, in which nothing is an annotation.
    success: whether its task was achieved; None where that is not known.
    quantities: what the dimensions of `state` and `achieved` measure, and what bounds the actions.
    unobserved_step: `action` (A,), and `reward` where there are rewards, of a step that others recorded after the last
        observation. Nobody saw where it led: nothing is learned from it, and it is written back to their format. {} of
        any other recording.
    """

    environment: Mapping[str, Any]
    state_names: tuple[str, ...]
    achieved_names: tuple[str, ...]
    action_names: tuple[str, ...]
    fps: float
    seed: int
    actor: str
    skills: tuple[str, ...] = ()
    controller: Mapping[str, Any] = field(default_factory=dict)
    cameras: Mapping[str, Any] = field(default_factory=dict)
    renderer: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    ended: str = "length"
    task: str = ""
    split: str = ""
    verbatim: bool = False
    success: bool | None = None
    quantities: Quantities = field(default_factory=Quantities)
    unobserved_step: Mapping[str, Any] = field(default_factory=dict)

    def annotations(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """The skill and the marks behind each value of `skill`; one without a name where there are none."""
        if self.verbatim:
            return tuple((text, ()) for text in self.skills) or (("", ()),)
        return tuple(map(read_annotation, self.skills)) or (("", ()),)


@dataclass(frozen=True, eq=False)
class Episode:
    """T actions and T + 1 observations.

    meta: where it comes from.
    state: (T+1, S) float32.
    achieved: (T+1, G) float32.
    sim_state: (T+1, N) float64, restores the simulator exactly.
    time: (T+1,) float64 seconds, strictly increasing.
    action: (T, A) float32, executed.
    expert_action: (T, A) float32, the label.
    intervention: (T,) bool.
    skill: (T,) int16, an index into `meta.skills`.
    images: camera -> (T+1, h, w, 3) uint8, upright.
    reward: (T,) float64 as it was recorded, whatever it means; None where there is none.

    Raises:
        EpisodeError: lengths disagree, a value is not finite, time does not go forward, T is 0, two dimensions of a
            vector have one name.
    """

    meta: EpisodeMeta
    state: Array
    achieved: Array
    sim_state: Array
    time: Array
    action: Array
    expert_action: Array
    intervention: Array
    skill: Array
    images: Mapping[str, Array] = field(default_factory=dict)
    reward: Array | None = None

    def __post_init__(self) -> None:
        steps = len(self.action)
        if steps == 0:
            raise EpisodeError("an episode needs at least one action")
        for name, (dtype, width, extra) in _fields(self).items():
            value = getattr(self, name)
            _check(name, value, dtype, steps + extra, width)
        if self.reward is not None:
            _check(REWARD, self.reward, np.float64, steps, None)
        self._check_names()
        self._check_unobserved()
        for camera, frames in self.images.items():
            _check(IMAGES + camera, frames, np.uint8, steps + 1, None)
            if frames.ndim != 4 or frames.shape[3] != 3:
                raise EpisodeError(f"{IMAGES}{camera} must be (T+1, h, w, 3), got {frames.shape}")
        if not (np.diff(self.time) > 0).all():
            first = int(np.argmax(np.diff(self.time) <= 0))
            raise EpisodeError(f"time does not go forward after step {first}: the simulator was reset in mid-episode")
        if self.skill.min() < 0 or self.skill.max() >= max(len(self.meta.skills), 1):
            raise EpisodeError(f"skill indexes {self.skill.max()}, but meta.skills has {len(self.meta.skills)} names")
        object.__setattr__(self, "images", MappingProxyType(dict(self.images)))
        for value in self.arrays().values():
            value.flags.writeable = False

    def _check_names(self) -> None:
        """Raises EpisodeError where two dimensions have one name, or not all of them are declared."""
        meta, given = self.meta, self.meta.quantities
        parts = ("state", meta.state_names), ("achieved", meta.achieved_names), ("action", meta.action_names)
        for part, names in parts:
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise EpisodeError(f"{part}_names has {twice!r} twice: what its dimensions are called must differ")
            field_name = "action_bounds" if part == "action" else part
            declared = getattr(given, field_name)
            if declared and len(declared) != len(names):
                raise EpisodeError(f"meta.quantities.{field_name} declares {len(declared)} of {len(names)} numbers")

    def _check_unobserved(self) -> None:
        """Raises EpisodeError where the step after the last observation is not of the kind of the others."""
        for key, value in self.meta.unobserved_step.items():
            recorded = {"action": self.action, REWARD: self.reward}.get(key)
            if recorded is None or np.shape(value) != recorded.shape[1:] or not np.isfinite(value).all():
                raise EpisodeError(
                    f"the {key} of the step after the last observation is no {key} of this episode: {value}"
                )

    def __len__(self) -> int:
        """T, the number of actions."""
        return len(self.action)

    def arrays(self) -> dict[str, Array]:
        """Every array under its stored name (`observation.state`, `action`, ...)."""
        plain = {stored: getattr(self, name) for name, stored in STORED.items()}
        plain |= {} if self.reward is None else {REWARD: self.reward}
        return plain | {IMAGES + camera: frames for camera, frames in self.images.items()}

    @classmethod
    def from_arrays(cls, meta: EpisodeMeta, arrays: Mapping[str, Array]) -> "Episode":
        """The episode that `arrays()` described; raises EpisodeError where an array is missing."""
        missing = [stored for stored in STORED.values() if stored not in arrays]
        if missing:
            raise EpisodeError(f"an episode without {', '.join(missing)}")
        images = {key.removeprefix(IMAGES): value for key, value in arrays.items() if key.startswith(IMAGES)}
        stored = {name: arrays[key] for name, key in STORED.items()}
        return cls(meta=meta, images=images, reward=arrays.get(REWARD), **stored)


def annotation(skill: str, marks: Sequence[str] = ()) -> str:
    """The value of `Decision.skill`: the skill's name, then marks of the step: `stack_red:open_loop:slip`."""
    return ":".join((skill, *marks))


def read_annotation(text: str) -> tuple[str, tuple[str, ...]]:
    """The skill's name and the marks of an `annotation`."""
    skill, *marks = text.split(":")
    return skill, tuple(marks)


STORED = {
    "state": "observation.state",
    "achieved": "achieved",
    "sim_state": "sim.state",
    "time": "time",
    "action": "action",
    "expert_action": "expert_action",
    "intervention": "intervention",
    "skill": "skill",
}


def _fields(episode: Episode) -> dict[str, tuple[Any, int | None, int]]:
    """Field -> (dtype, width or None for a vector, rows beyond T)."""
    meta = episode.meta
    actions = len(meta.action_names)
    return {
        "state": (np.float32, len(meta.state_names), 1),
        "achieved": (np.float32, len(meta.achieved_names), 1),
        "sim_state": (np.float64, episode.sim_state.shape[-1], 1),
        "time": (np.float64, None, 1),
        "action": (np.float32, actions, 0),
        "expert_action": (np.float32, actions, 0),
        "intervention": (np.bool_, None, 0),
        "skill": (np.int16, None, 0),
    }


def _check(name: str, value: Array, dtype: Any, rows: int, width: int | None) -> None:
    if value.dtype != dtype:
        raise EpisodeError(f"{name} must be {np.dtype(dtype)}, got {value.dtype}")
    if len(value) != rows:
        raise EpisodeError(f"{name} has {len(value)} rows where {rows} were expected")
    if width is not None and value.shape != (rows, width):
        raise EpisodeError(f"{name} must have shape {(rows, width)}, got {value.shape}")
    if np.issubdtype(value.dtype, np.floating) and not np.isfinite(value).all():
        flat = value.reshape(rows, -1)
        step, dimension = np.argwhere(~np.isfinite(flat))[0]
        raise EpisodeError(f"{name} is not finite at step {step}: dimension {dimension} is {flat[step, dimension]}")
