"""Tasks whose start and goal a benchmark defines: no expert has to reach the goal first."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.errors import UsageError
from playlearn.evaluation.goal_generation import achieved_now, names_of
from playlearn.evaluation.suite import EvalEpisode, SuiteKind, derived_seed, goal_from
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment


@SuiteKind.register_subclass("fixed_tasks")
@dataclass(frozen=True)
class FixedTasksConfig(SuiteKind):
    """Episode e has task e modulo the number of tasks, from the task's own start to its own goal.

    tasks: names (null: all of the environment).
    """

    tasks: tuple[str, ...] | None = None

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        task = environment.tasks[names[episode % len(names)]]
        if task.pose is None:
            raise UsageError(f"kind: task {task.name!r} has no goal of its own here; use a suite of `type: tasks`")
        goal_sim_state = task.pose(environment, np.random.default_rng((seed, episode)))
        start, start_achieved = np.array(environment.sim_state()), achieved_now(environment)
        environment.set_state(goal_sim_state)
        return EvalEpisode(
            episode=episode,
            task=task.name,
            start_sim_state=start,
            start_achieved=start_achieved,
            goal=goal_from(environment, cameras),
            goal_sim_state=goal_sim_state,
            seed=derived_seed(seed, episode),
        )
