"""Several goals in a row without a reset, shown one after the other (CALVIN's measure, Mees et al. 2022)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.goal_generation import DRAWS, GoalGeneration, beginnings, names_of
from playlearn.evaluation.suite import EvalEpisode, Judge, SuiteKind, derived_seed
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment


@SuiteKind.register_subclass("chains")
@dataclass(frozen=True)
class ChainsConfig(SuiteKind):
    """Each goal is what the expert reached from where the goal before it shows the world; see `sequence`.

    The policy goes on from wherever it really is, and each goal has `max_steps` of its own; a chain ends at the
    first that is not reached. A link is judged as its task, from the state in which the policy began it, so that
    only what it changed counts, as in CALVIN; or it is reached because everything is where the goal shows it.

    tasks: what is drawn from (null: all that the environment has). links: goals in a row. rest, rest_seconds: see
    `TasksConfig`.
    """

    tasks: tuple[str, ...] | None = None
    links: int = 5
    rest: float = 0.003
    rest_seconds: float = 0.5

    def __post_init__(self) -> None:
        if self.links < 1:
            raise UsageError(f"kind.links must be 1 or more, got {self.links}")

    def prepare(self, run: Path | None) -> Self:
        return self

    def judge(self, environment: Environment, task: str) -> Judge:
        judge = environment.tasks[task].judge

        def content(start: Array, achieved: Array, goal: Array) -> bool:
            # What went wrong, or by luck right, before may have left the task nothing to do that its judge would see.
            return judge(start, achieved, goal) or environment.reached(achieved, goal)

        return content

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        demonstration = GoalGeneration(self.rest, self.rest_seconds)
        longest = 0
        for draw, rng, start, start_achieved in beginnings(environment, seed, episode):
            links = demonstration.sequence(environment.clone(), expert, names, self.links, rng, max_steps, cameras)
            longest = max(longest, len(links))
            if len(links) < self.links:
                continue
            return EvalEpisode(
                episode=episode,
                task=links[0].task,
                start=start,
                start_achieved=start_achieved,
                goal=links[0].goal,
                goal_sim_state=links[0].goal_sim_state,
                seed=derived_seed(seed, episode),
                redraws=draw,
                then=tuple(links[1:]),
            )
        raise PlaylearnError(
            f"the expert did not do {self.links} tasks in a row in {DRAWS} draws of episode {episode}, at most "
            f"{longest}. Ask for fewer `kind.links`, allow other `kind.tasks`, or raise max_steps ({max_steps})"
        )
