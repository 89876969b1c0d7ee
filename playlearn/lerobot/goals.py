"""Relabeled play for policies without goals: each window of play is an episode that carries its goal.

    an episode of play   0 ---------- 61 -------------- 140 ---- ... T
    its windows          [0, 61) goal 61   [61, 140) goal 140    [140, ...

A window ends where its goal is reached and the next one begins there, so that every step with a later goal is in one.
All frames of a window have these columns besides those of plain play:

    observation.images.goal_<camera>   (h, w, 3)   image of the goal
    observation.goal.state             (G,)        objects and fixtures in the goal, if any are recorded
    observation.goal.proprio           (S,)        the robot's own state in the goal
    observation.environment_state      (2 G,)      achieved goal and goal: LeRobot's policies read no other states
                                                   than this one and the robot's
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
    declared,
    flags,
    image_features,
    steps,
    subtasks,
    vectors,
)

GOAL_IMAGES, GOAL_STATE, GOAL_PROPRIO = IMAGES + "goal_", "observation.goal.state", "observation.goal.proprio"


@dataclass(frozen=True)
class RelabelConfig:
    """How play is relabeled for export.

    goals: goal sampler; it must draw later moments only.
    settling: how settled moments are found.
    goal_names: dimensions that goals are about, as in training.
    cameras: that show the goal (null: all).
    seed: of the sampler.
    """

    goals: GoalSamplerConfig = field(default_factory=SettledConfig)
    settling: SettlingConfig = field(default_factory=SettlingConfig)
    goal_names: tuple[str, ...] = ("*",)
    cameras: tuple[str, ...] | None = None
    seed: int = 0


@dataclass(frozen=True)
class Window:
    """Steps begin ... goal-1 of an episode, which end in observation `goal`."""

    episode: int
    begin: int
    goal: int


@dataclass
class Windows:
    """A relabeled store: one entry a window (see `content.Content`).

    The task of a window is its episode's, or its last skill.

    store: of the play.
    config: of the relabeling.
    annotated: write skills as subtasks.
    """

    store: Store
    config: RelabelConfig
    annotated: bool = False

    def __len__(self) -> int:
        return len(self.windows)

    @cached_property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that show the goal; raises UsageError if the store lacks one."""
        known = self.store.cameras()
        wanted = tuple(known) if self.config.cameras is None else self.config.cameras
        missing = [camera for camera in wanted if camera not in known]
        if missing:
            raise UsageError(
                f"{self.store.name()} has no images of {', '.join(missing)}; it has: {', '.join(known) or 'none'}"
            )
        return wanted

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """Raises StoreError if no step has a later goal, UsageError if a drawn goal is not a later moment."""
        config = self.config
        index = RelabelIndex.of_store(self.store, config.settling, config.goal_names)
        sampler = config.goals.build()
        found = []
        for episode in range(len(self.store)):
            length = int(index.lengths[episode])
            moments = np.arange(length)
            own = np.full(length, episode)
            valid = sampler.valid(index, own, moments)
            uniforms = counter_uniforms(config.seed, 0, index.starts[episode] + moments, UNIFORMS)
            goals = np.zeros(length, np.int64)
            goals[valid] = sampler.draw(index, own[valid], moments[valid], uniforms[valid])
            if (valid & ((goals <= moments) | (goals > length))).any():
                raise UsageError(
                    "goals: this sampler draws moments that are not later; choose one that draws later moments"
                )
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
        goal, proprio = (tuple(f"goal.{name}" for name in own) for own in (spec.achieved_names, spec.state_names))
        seen = {STATE: spec.state_names, ACHIEVED: (*spec.achieved_names, *goal), ACTION: spec.action_names}
        given = spec.quantities
        measured = {
            STATE: given.state,
            ACHIEVED: 2 * given.achieved,
            GOAL_STATE: given.achieved,
            GOAL_PROPRIO: given.state,
        }
        made = declared(vectors({**seen, GOAL_STATE: goal, GOAL_PROPRIO: proprio}), measured, given)
        sizes = self.store.cameras()
        goals = {f"goal_{camera}": sizes[camera] for camera in self.cameras}
        return made | flags(INTERVENTION, SUCCESS) | image_features(sizes | goals)

    def entry(self, i: int) -> Entry:
        window = self.windows[i]
        episode = self.store.read(window.episode)
        count = window.goal - window.begin
        arrays = episode.arrays()

        def repeated(key: str) -> Array:
            """(count, ...) the observation of the goal, repeated for each frame."""
            return np.repeat(arrays[key][window.goal][None], count, axis=0)

        columns = steps(episode, window.begin, window.goal)
        columns[GOAL_PROPRIO] = repeated(STORED["state"])
        if ACHIEVED in columns:
            columns[GOAL_STATE] = repeated(STORED["achieved"])
            columns[ACHIEVED] = np.concatenate([columns[ACHIEVED], columns[GOAL_STATE]], axis=1)
        success = np.arange(count)[:, None] == count - 1
        goal_images = {GOAL_IMAGES + camera: repeated(IMAGES + camera) for camera in self.cameras}
        skills = subtasks(episode, window.begin, window.goal)
        task = episode.meta.task or (skills[-1][1] if skills else PLAY)
        columns |= {SUCCESS: success} | goal_images
        return Entry(columns, (task,) * count, skills if self.annotated else ())
