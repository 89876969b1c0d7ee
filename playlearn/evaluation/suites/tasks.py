"""Named tasks from random starts; the goal is the state that the expert reached from the same start."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.goal_generation import DRAWS, GoalGeneration, achieved_now, names_of
from playlearn.evaluation.suite import EvalEpisode, SuiteKind, derived_seed, goal_from
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment, Parkable


@SuiteKind.register_subclass("tasks")
@dataclass(frozen=True)
class TasksConfig(SuiteKind):
    """Episode e has task e modulo the number of tasks; success is that of the task.

    tasks: names (null: all of the environment).
    rest: the expert's goal is settled once no dimension of `achieved` moves more than this ...
    rest_seconds: ... for so long.
    parked: whether goal images show the robot where it was at the start, so that nothing can be read off its arm.
    """

    tasks: tuple[str, ...] | None = None
    rest: float = 0.003
    rest_seconds: float = 0.5
    parked: bool = False

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> EvalEpisode:
        names = names_of(environment, self.tasks)
        task = environment.tasks[names[episode % len(names)]]
        generation = GoalGeneration(self.rest, self.rest_seconds)
        failure: str | None = "its start state was not suitable"
        for draw in range(DRAWS):
            rng = np.random.default_rng((seed, episode, draw))
            environment.reset(int(rng.integers(2**31)))
            task.arrange(environment, rng)
            start, start_achieved = np.array(environment.sim_state()), achieved_now(environment)
            if environment.failure() is not None or not task.precondition(start_achieved):
                continue
            copy = environment.clone()
            failure = generation.drive(copy, expert, task, rng, max_steps)
            if failure:
                continue
            goal_sim_state = np.array(copy.sim_state())
            if self.parked:
                _park(copy, start)
            return EvalEpisode(
                episode=episode,
                task=task.name,
                start_sim_state=start,
                start_achieved=start_achieved,
                goal=goal_from(copy, cameras),
                goal_sim_state=goal_sim_state,
                seed=derived_seed(seed, episode),
                redraws=draw,
            )
        raise PlaylearnError(
            f"the expert did not do task {task.name!r} in {DRAWS} draws of episode {episode} (the last: {failure}), so "
            f"there is no goal to show. Leave it out of the suite's `kind.tasks`, or raise max_steps ({max_steps})"
        )


def _park(environment: Environment, start: Array) -> None:
    """Put the robot where it was at the start. Raises UsageError where the environment cannot."""
    if not isinstance(environment, Parkable):
        raise UsageError("kind.parked: this environment cannot put its robot elsewhere (`park`); set it to false")
    environment.park(start)
