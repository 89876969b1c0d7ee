"""Far goals: one image of a world in which several things have changed (as OGBench asks, Park et al. 2025)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.goal_generation import DRAWS, GoalGeneration, beginnings, names_of
from playlearn.evaluation.objects import misplaced
from playlearn.evaluation.suite import ChainGoal, EvalEpisode, Judge, SuiteKind, derived_seed
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment


@SuiteKind.register_subclass("multi_change")
@dataclass(frozen=True)
class MultiChangeConfig(SuiteKind):
    """The expert does several tasks in a row, and only where that led to is shown; judged on everything it shows.

    What each task was about is still so in the end, and at least as many things are elsewhere. An episode has
    `max_steps` for each change.

    changes: how many tasks; episode e has number e modulo how many are given. tasks, rest, rest_seconds: see
    `TasksConfig`.
    """

    changes: tuple[int, ...] = (2, 3)
    tasks: tuple[str, ...] | None = None
    rest: float = 0.003
    rest_seconds: float = 0.5

    def __post_init__(self) -> None:
        if not self.changes or min(self.changes) < 1:
            raise UsageError(f"kind.changes must be numbers of 1 or more, got {list(self.changes)}")

    def prepare(self, run: Path | None) -> Self:
        return self

    def judge(self, environment: Environment, task: str) -> Judge:
        return lambda _start, achieved, goal: environment.reached(achieved, goal)

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        demonstration = GoalGeneration(self.rest, self.rest_seconds)
        changes = self.changes[episode % len(self.changes)]
        for draw, rng, start, start_achieved in beginnings(environment, seed, episode):
            links = demonstration.sequence(environment.clone(), expert, names, changes, rng, max_steps, cameras)
            if len(links) < changes or not _all_shown(environment, start_achieved, links):
                continue
            return EvalEpisode(
                episode=episode,
                task="1 change" if changes == 1 else f"{changes} changes",
                start=start,
                start_achieved=start_achieved,
                goal=links[-1].goal,
                goal_sim_state=links[-1].goal_sim_state,
                seed=derived_seed(seed, episode),
                redraws=draw,
                made_by=", ".join(link.task for link in links),
                max_steps=changes * max_steps,
            )
        raise PlaylearnError(
            f"the expert did not show {changes} changes at once in {DRAWS} draws of episode {episode}. Ask for fewer "
            f"`kind.changes`, allow other `kind.tasks`, or raise max_steps ({max_steps})"
        )


def _all_shown(environment: Environment, start: Array, links: Sequence[ChainGoal]) -> bool:
    """Whether what each task was about can still be seen in the last state, and in as many things."""
    if len(misplaced(environment, start, links[-1].goal.achieved)) < len(links):
        return False
    begins = [start, *(link.goal.achieved for link in links)]
    return all(
        environment.tasks[link.task].judge(before, links[-1].goal.achieved, link.goal.achieved)
        for before, link in zip(begins, links, strict=False)
    )
