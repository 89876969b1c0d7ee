"""A suite: a file that fixes start states, goals, tolerances and step budgets of an evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import draccus
import numpy as np

from playlearn.config import load_config
from playlearn.episode import Array, Goal
from playlearn.errors import UsageError
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment, EnvironmentConfig

Judge = Callable[[Array, Array, Array], bool]


@dataclass(frozen=True, eq=False)
class ChainGoal:
    """One goal, and the task it is judged as. goal_state: (N,) float64; goal: what the policy is shown of it."""

    task: str
    goal: Goal
    goal_sim_state: Array


@dataclass(frozen=True, eq=False)
class EvalEpisode:
    """One episode to be attempted.

    start, goal_state: (N,) float64 simulator states. goal: what the policy is shown of the latter.
    redraws: how many draws were thrown away before this one. seed: the attempting actor's randomness.
    then: goals that follow without a reset, each once the one before it is reached. made_by: what the expert did
    for the goal, where the task's name does not say. max_steps: the budget of each goal (None: the suite's).
    """

    episode: int
    task: str
    start: Array
    start_achieved: Array
    goal: Goal
    goal_sim_state: Array
    seed: int
    redraws: int = 0
    then: tuple[ChainGoal, ...] = ()
    made_by: str = ""
    max_steps: int | None = None

    @property
    def links(self) -> tuple[ChainGoal, ...]:
        """All goals in their order."""
        return (ChainGoal(self.task, self.goal, self.goal_sim_state), *self.then)


@dataclass(frozen=True)
class SuiteKind(draccus.ChoiceRegistry):
    """Where start states and goals come from; `type:` in a suite's `kind:` picks one."""

    def prepare(self, run: Path | None) -> "SuiteKind":
        """Complete from the run that is evaluated what the suite leaves open; before any simulation.

        Raises:
            PlaylearnError: something that the suite is made from is missing.
        """
        raise NotImplementedError

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        """Episode number `episode` of the suite under `seed`, whatever was set up before.

        The goal is shown through `cameras`. Leaves the environment in any state.

        Raises:
            PlaylearnError: no such episode can be made.
        """
        raise NotImplementedError

    def judge(self, environment: Environment, task: str) -> Judge:
        """(start, achieved, goal) -> bool, each (G,): what success means in a task of this suite."""
        raise NotImplementedError


@dataclass(frozen=True)
class SuiteConfig:
    """What an evaluation repeats exactly whenever it is run.

    environment: the world. kind: where starts and goals come from. episodes: in all, spread evenly
    over the tasks. max_steps: the budget of a goal. hold: for how many consecutive steps the
    judge must be content. cohort: how many episodes are stepped together (and planned for in one batch).
    n_action_steps, guidance: how a trained policy acts (null: as is usual for it). subgoals: a run that proposes
    them, each for `subgoal_seconds` at most (null: the policy acts on the goal itself). picture: height of
    the report's pictures in pixels, as seen through `camera`.
    """

    name: str
    environment: EnvironmentConfig
    kind: SuiteKind
    episodes: int = 100
    seed: int = 0
    max_steps: int = 300
    success_hold_steps: int = 5
    num_envs: int = 8
    n_action_steps: int | None = None
    guidance: float | None = None
    subgoals: Path | None = None
    subgoal_seconds: float = 4.0
    picture: int = 192
    camera: str = "front"

    def __post_init__(self) -> None:
        for name in ("episodes", "max_steps", "success_hold_steps", "num_envs", "picture"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} must be 1 or more, got {getattr(self, name)}")
        if self.success_hold_steps > self.max_steps:
            raise UsageError(
                f"hold ({self.success_hold_steps}) is longer than max_steps ({self.max_steps}): nothing could succeed"
            )

    def batches(self) -> list[tuple[int, ...]]:
        """The numbers of the episodes that are stepped together; never depends on the number of workers."""
        numbers = range(self.episodes)
        return [tuple(numbers[i : i + self.num_envs]) for i in range(0, self.episodes, self.num_envs)]


def load_suite(path: Path, overrides: Sequence[str] = ()) -> SuiteConfig:
    """The suite that a file describes; raises UsageError where it does not."""
    return load_config(SuiteConfig, path, overrides)


def derived_seed(*parts: int) -> int:
    """A seed that is a function of its parts alone."""
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def goal_from(environment: Environment, cameras: Sequence[str]) -> Goal:
    """What the world shows right now, as a goal."""
    seen = environment.observe(tuple(cameras))
    return Goal(
        achieved=np.array(seen.achieved, dtype=np.float32),
        images={camera: np.array(image) for camera, image in seen.images.items()},
        state=np.array(seen.state, dtype=np.float32),
    )
