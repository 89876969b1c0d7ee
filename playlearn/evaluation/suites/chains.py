"""Several goals in a row without a reset, shown one after the other (CALVIN's measure, Mees et al. 2022)."""

from collections.abc import Sequence
from dataclasses import dataclass

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.goal_generation import DRAWS, GoalGeneration, names_of, start_states
from playlearn.evaluation.suite import EvalEpisode, Judge, SuiteKind, derived_seed
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment


@SuiteKind.register_subclass("chains")
@dataclass(frozen=True)
class ChainsConfig(SuiteKind):
    """Goals in a row; each is the state that the expert reached from the previous goal (see `sequence`).

    The policy goes on from wherever it really is, and each goal has its own `max_steps`. A chain ends at the first
    goal that is not reached. Success is that of the goal's task, from the state in which the policy began it, so that
    only its own changes count, as in CALVIN; or everything is where the goal shows it.

    tasks: that goals are drawn from (null: all of the environment).
    num_goals: goals in a row.
    rest: see `TasksConfig`.
    rest_seconds: see `TasksConfig`.
    """

    tasks: tuple[str, ...] | None = None
    num_goals: int = 5
    rest: float = 0.003
    rest_seconds: float = 0.5

    def __post_init__(self) -> None:
        if self.num_goals < 1:
            raise UsageError(f"kind.num_goals must be 1 or more, got {self.num_goals}")

    def judge(self, environment: Environment, task: str) -> Judge:
        judge = environment.tasks[task].judge

        def success(start: Array, achieved: Array, goal: Array) -> bool:
            # Earlier errors, or accidents, may have done the task before it begins; its judge would not count that.
            return judge(start, achieved, goal) or environment.reached(achieved, goal)

        return success

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        generation = GoalGeneration(self.rest, self.rest_seconds)
        longest = 0
        for draw, rng, start, start_achieved in start_states(environment, seed, episode):
            goals = generation.sequence(environment.clone(), expert, names, self.num_goals, rng, max_steps, cameras)
            longest = max(longest, len(goals))
            if len(goals) < self.num_goals:
                continue
            return EvalEpisode(
                episode=episode,
                task=goals[0].task,
                start_sim_state=start,
                start_achieved=start_achieved,
                goal=goals[0].goal,
                goal_sim_state=goals[0].goal_sim_state,
                seed=derived_seed(seed, episode),
                redraws=draw,
                next_goals=tuple(goals[1:]),
            )
        raise PlaylearnError(
            f"the expert did not do {self.num_goals} tasks in a row in {DRAWS} draws of episode {episode}, at most "
            f"{longest}. Ask for fewer `kind.num_goals`, allow other `kind.tasks`, or raise max_steps ({max_steps})"
        )
