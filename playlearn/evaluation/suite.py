"""A suite: a file that fixes start states, goals, tolerances and step budgets of an evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
    """One goal of an episode.

    task: whose judge decides success.
    goal: what the policy is shown.
    goal_sim_state: (N,) float64.
    """

    task: str
    goal: Goal
    goal_sim_state: Array


@dataclass(frozen=True, eq=False)
class EvalEpisode:
    """One episode of a suite.

    episode: its number.
    task: whose judge decides success.
    start_sim_state: (N,) float64.
    start_achieved: (G,) achieved goal at the start.
    goal: what the policy is shown.
    goal_sim_state: (N,) float64.
    seed: of the actor.
    redraws: start states that were drawn and rejected before this one.
    next_goals: further goals without a reset, each given once the previous one is reached.
    expert_tasks: tasks that the expert did to make the goal, if `task` does not name them.
    max_steps: step budget of each goal (None: the suite's).
    """

    episode: int
    task: str
    start_sim_state: Array
    start_achieved: Array
    goal: Goal
    goal_sim_state: Array
    seed: int
    redraws: int = 0
    next_goals: tuple[ChainGoal, ...] = ()
    expert_tasks: str = ""
    max_steps: int | None = None

    @property
    def goals(self) -> tuple[ChainGoal, ...]:
        """All goals, in order."""
        return (ChainGoal(self.task, self.goal, self.goal_sim_state), *self.next_goals)


@dataclass(frozen=True)
class SuiteKind(draccus.ChoiceRegistry):
    """Where start states and goals come from; `type:` in a suite's `kind:` picks one."""

    def prepare(self, run: Path | None) -> "SuiteKind":
        """Fill in what the suite leaves open from the run that is evaluated; called before any simulation.

        Raises:
            PlaylearnError: data that the suite is made from is missing.
        """
        return self

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        """Episode number `episode` of the suite under `seed`, independent of earlier calls.

        The goal is shown through `cameras`. Leaves the environment in any state.

        Raises:
            PlaylearnError: the episode cannot be made.
        """
        raise NotImplementedError

    def judge(self, environment: Environment, task: str) -> Judge:
        """(start, achieved, goal) -> bool, each (G,): the success criterion in this suite; by default the task's."""
        return environment.tasks[task].judge


@dataclass(frozen=True)
class SuiteConfig:
    """Config of an evaluation; the same suite gives the same episodes whenever it is run.

    name: of the suite.
    environment: config of the environment.
    kind: where start states and goals come from.
    episodes: total, spread evenly over the tasks.
    seed: of start states and goals.
    max_steps: step budget of a goal.
    success_hold_steps: consecutive steps for which the judge must be satisfied.
    num_envs: episodes that are stepped together (and planned for in one batch).
    n_action_steps: actions of a chunk that are executed before the next plan (null: half of the chunk).
    guidance: weight of the goal (null: the policy's default).
    subgoals: run of the high-level policy that proposes subgoals (null: none).
    subgoal_seconds: at most so long is each subgoal pursued.
    picture: height of the report's pictures, in pixels.
    camera: of the report's pictures.
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
                f"success_hold_steps ({self.success_hold_steps}) is longer than max_steps "
                f"({self.max_steps}): nothing could succeed"
            )

    def batches(self) -> list[tuple[int, ...]]:
        """The episodes that are stepped together; independent of the number of workers."""
        numbers = range(self.episodes)
        return [tuple(numbers[i : i + self.num_envs]) for i in range(0, self.episodes, self.num_envs)]


def load_suite(path: Path, overrides: Sequence[str] = ()) -> SuiteConfig:
    """The suite of a file; raises UsageError if the file is no valid suite."""
    return load_config(SuiteConfig, path, overrides)


def prepared_suite(
    path: Path, run: Path | None, episodes: int | None, seed: int | None, overrides: Sequence[str]
) -> SuiteConfig:
    """The suite of a file as it is evaluated: with these episodes and this seed, and completed from the run.

    Raises:
        UsageError: the file is no valid suite, or an override is wrong.
        PlaylearnError: data that the suite is made from is missing.
    """
    given = {"episodes": episodes, "seed": seed}
    suite = load_suite(path, [*overrides, *(f"--{k}={v}" for k, v in given.items() if v is not None)])
    return replace(suite, kind=suite.kind.prepare(run))


def derived_seed(*parts: int) -> int:
    """A seed that is a function of its parts alone."""
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def goal_from(environment: Environment, cameras: Sequence[str]) -> Goal:
    """The present state of the environment, as a goal."""
    now = environment.observe(tuple(cameras))
    return Goal(
        achieved=np.array(now.achieved, dtype=np.float32),
        images={camera: np.array(image) for camera, image in now.images.items()},
        state=np.array(now.state, dtype=np.float32),
    )
