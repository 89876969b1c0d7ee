"""Distant goals: one goal in which several objects have changed (as in OGBench, Park et al. 2025)."""

from collections.abc import Sequence
from dataclasses import dataclass

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.goal_generation import DRAWS, GoalGeneration, names_of, start_states
from playlearn.evaluation.objects import misplaced
from playlearn.evaluation.suite import ChainGoal, EvalEpisode, Judge, SuiteKind, derived_seed
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment


@SuiteKind.register_subclass("multi_change")
@dataclass(frozen=True)
class MultiChangeConfig(SuiteKind):
    """The expert does several tasks in a row; the goal is the final state, and success is all of it.

    The result of every task is still there in the final state, and at least as many objects have changed. An episode
    has `max_steps` for each change.

    changes: numbers of tasks; episode e takes entry e modulo their count.
    tasks: see `TasksConfig`.
    rest: see `TasksConfig`.
    rest_seconds: see `TasksConfig`.
    """

    changes: tuple[int, ...] = (2, 3)
    tasks: tuple[str, ...] | None = None
    rest: float = 0.003
    rest_seconds: float = 0.5

    def __post_init__(self) -> None:
        if not self.changes or min(self.changes) < 1:
            raise UsageError(f"kind.changes must be numbers of 1 or more, got {list(self.changes)}")

    def judge(self, environment: Environment, task: str) -> Judge:
        return lambda _start, achieved, goal: environment.reached(achieved, goal)

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        generation = GoalGeneration(self.rest, self.rest_seconds)
        changes = self.changes[episode % len(self.changes)]
        for draw, rng, start, start_achieved in start_states(environment, seed, episode):
            goals = generation.sequence(environment.clone(), expert, names, changes, rng, max_steps, cameras)
            if len(goals) < changes or not _all_visible(environment, start_achieved, goals):
                continue
            return EvalEpisode(
                episode=episode,
                task="1 change" if changes == 1 else f"{changes} changes",
                start_sim_state=start,
                start_achieved=start_achieved,
                goal=goals[-1].goal,
                goal_sim_state=goals[-1].goal_sim_state,
                seed=derived_seed(seed, episode),
                redraws=draw,
                expert_tasks=", ".join(goal.task for goal in goals),
                max_steps=changes * max_steps,
            )
        raise PlaylearnError(
            f"the expert did not show {changes} changes at once in {DRAWS} draws of episode {episode}. Ask for fewer "
            f"`kind.changes`, allow other `kind.tasks`, or raise max_steps ({max_steps})"
        )


def _all_visible(environment: Environment, start: Array, goals: Sequence[ChainGoal]) -> bool:
    """Whether the result of every task is still there in the last state, and as many objects have changed."""
    if len(misplaced(environment, start, goals[-1].goal.achieved)) < len(goals):
        return False
    starts = [start, *(goal.goal.achieved for goal in goals)]
    return all(
        environment.tasks[goal.task].judge(before, goals[-1].goal.achieved, goal.goal.achieved)
        for before, goal in zip(starts, goals, strict=False)
    )
