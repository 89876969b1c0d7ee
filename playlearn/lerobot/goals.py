"""Play relabeled for policies that know nothing of goals: each window of it an episode that carries its goal.

    an episode of play   0 ---------- 61 -------------- 140 ---- ... T
    its windows          [0, 61) goal 61   [61, 140) goal 140    [140, ...

A window ends where its goal is reached and the next begins there, so that every step with a later goal is in one.
Beside the columns of plain play, all frames of a window say

    observation.images.goal_<camera>   (h, w, 3)   what the camera sees in the goal
    observation.goal.state             (G,)        objects and fixtures there (the robot, where no more is known)
    observation.environment_state      (2 G,)      what the objects are and what they shall be: of states LeRobot's
                                                   policies read this one and the robot's own only
    next.success                       (1,) bool   at its last frame
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from playlearn.episode import IMAGES, STORED, Array
from playlearn.errors import StoreError, UsageError
from playlearn.relabeling import (
    UNIFORMS,
    GoalSamplerConfig,
    RelabelIndex,
    SettledConfig,
    SettlingConfig,
    counter_uniforms,
)
from playlearn.store import Store
from playlearn.store.lerobot.content import (
    ACHIEVED,
    ACTION,
    INTERVENTION,
    PLAY,
    STATE,
    SUCCESS,
    Entry,
    Features,
    flags,
    image_features,
    steps,
    subtasks,
    vectors,
)

GOAL_IMAGES, GOAL_STATE = IMAGES + "goal_", "observation.goal.state"


@dataclass(frozen=True)
class RelabelConfig:
    """goals: the sampler; it must draw later moments only. settling, goal_names: as in training.

    cameras: those that show the goal; null for all. seed: the same one gives the same windows.
    """

    goals: GoalSamplerConfig = field(default_factory=SettledConfig)
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    goal_names: tuple[str, ...] = ("*",)
    cameras: tuple[str, ...] | None = None
    seed: int = 0


@dataclass(frozen=True)
class Window:
    """Steps begin ... goal-1 of an episode, which lead to observation `goal`."""

    episode: int
    begin: int
    goal: int


@dataclass
class Windows:
    """A store relabeled: one entry a window (see `content.Content`). annotated: with skills as subtasks.

    The task of a window is its episode's, or the skill that brings the goal about, in words.
    """

    store: Store
    config: RelabelConfig
    annotated: bool = False

    def __len__(self) -> int:
        return len(self.windows)

    @cached_property
    def cameras(self) -> tuple[str, ...]:
        """Raises UsageError where the store lacks one."""
        there = self.store.cameras()
        wanted = tuple(there) if self.config.cameras is None else self.config.cameras
        missing = [camera for camera in wanted if camera not in there]
        if missing:
            raise UsageError(
                f"{self.store.name()} has no images of {', '.join(missing)}; it has: {', '.join(there) or 'none'}"
            )
        return wanted

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """Raises StoreError where no step has a later goal, UsageError where a drawn goal is no later moment."""
        config = self.config
        table = RelabelIndex.of_store(self.store, config.settling, config.goal_names)
        sampler = config.goals.build()
        found = []
        for episode in range(len(self.store)):
            length = int(table.lengths[episode])
            every = np.arange(length)
            own = np.full(length, episode)
            valid = sampler.valid(table, own, every)
            uniforms = counter_uniforms(config.seed, 0, table.starts[episode] + every, UNIFORMS)
            goals = np.zeros(length, np.int64)
            goals[valid] = sampler.draw(table, own[valid], every[valid], uniforms[valid])
            if (valid & ((goals <= every) | (goals > length))).any():
                raise UsageError("goals: this sampler draws moments that no action leads to; take one of later moments")
            t = 0
            while t < length:
                if valid[t]:
                    found.append(Window(episode, t, int(goals[t])))
                t = int(goals[t]) if valid[t] else t + 1
        if not found:
            raise StoreError(
                f"{self.store.name()}: no step has a goal to draw; collect more play, or choose other `goals`"
            )
        return tuple(found)

    def features(self) -> Features:
        spec = self.store.spec
        shown = spec.achieved_names or spec.state_names
        wanted = tuple(f"goal.{name}" for name in shown)
        both = (*spec.achieved_names, *wanted) if spec.achieved_names else ()
        made = vectors({STATE: spec.state_names, ACHIEVED: both, ACTION: spec.action_names, GOAL_STATE: wanted})
        sizes = self.store.cameras()
        goals = {f"goal_{camera}": sizes[camera] for camera in self.cameras}
        return made | flags(INTERVENTION, SUCCESS) | image_features(sizes | goals)

    def entry(self, i: int) -> Entry:
        window = self.windows[i]
        episode = self.store.read(window.episode)
        count = window.goal - window.begin
        arrays = episode.arrays()

        def held(key: str) -> Array:
            """(count, ...) what is observed in the goal, at each frame."""
            return np.repeat(arrays[key][window.goal][None], count, axis=0)

        columns = steps(episode, window.begin, window.goal)
        goal = held(STORED["achieved"] if ACHIEVED in columns else STORED["state"])
        if ACHIEVED in columns:
            columns[ACHIEVED] = np.concatenate([columns[ACHIEVED], goal], axis=1)
        reached = np.arange(count)[:, None] == count - 1
        shown = {GOAL_IMAGES + camera: held(IMAGES + camera) for camera in self.cameras}
        spoken = subtasks(episode, window.begin, window.goal)
        task = episode.meta.task or (spoken[-1][1] if spoken else PLAY)
        columns |= {GOAL_STATE: goal, SUCCESS: reached} | shown
        return Entry(columns, (task,) * count, spoken if self.annotated else ())
