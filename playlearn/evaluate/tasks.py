"""Named tasks from random starts; the goal is what the expert really reached from that very start."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from playlearn.config.schema import nearest
from playlearn.episode import Array, Goal, Observation
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluate.suite import Judge, Setup, SuiteKind, derived_seed, goal_from
from playlearn.rollout import Actor, rollout
from playlearn.sim.environment import Environment, Task

DRAWS = 20


@SuiteKind.register_subclass("tasks")
@dataclass(frozen=True)
class TasksConfig(SuiteKind):
    """Episode e attempts task e modulo the number of tasks, judged on what that task is about.

    tasks: their names (null: all that the environment has). rest, rest_seconds: a goal counts as
    reached by the expert once nothing of `achieved` moved more than `rest` for so long.
    """

    tasks: tuple[str, ...] | None = None
    rest: float = 0.003
    rest_seconds: float = 0.5

    def prepare(self, run: Path | None) -> Self:
        return self

    def judge(self, environment: Environment, task: str) -> Judge:
        return environment.tasks[task].judge

    def setup(
        self, environment: Environment, expert: Actor, episode: int, seed: int, max_steps: int, cameras: Sequence[str]
    ) -> Setup:
        names = self._names(environment)
        task = environment.tasks[names[episode % len(names)]]
        why: str | None = "its start state did not suit"
        for draw in range(DRAWS):
            rng = np.random.default_rng((seed, episode, draw))
            environment.reset(int(rng.integers(2**31)))
            task.arrange(environment, rng)
            start, start_achieved = np.array(environment.sim_state()), _achieved(environment)
            if environment.failure() is not None or not task.precondition(start_achieved):
                continue
            twin = environment.clone()
            why = self._drive(twin, expert, task, rng, max_steps)
            if why:
                continue
            return Setup(
                episode=episode,
                task=task.name,
                start=start,
                start_achieved=start_achieved,
                goal=goal_from(twin, cameras),
                goal_state=np.array(twin.sim_state()),
                seed=derived_seed(seed, episode),
                redraws=draw,
            )
        raise PlaylearnError(
            f"the expert did not do task {task.name!r} in {DRAWS} draws of episode {episode} (the last: {why}), so "
            f"there is no goal to show. Leave it out of the suite's `kind.tasks`, or raise max_steps ({max_steps})"
        )

    def _names(self, environment: Environment) -> tuple[str, ...]:
        known = tuple(environment.tasks)
        for name in self.tasks or ():
            if name not in known:
                raise UsageError(f"kind.tasks: this environment has no task {name!r}{nearest(name, known)}")
        names = known if self.tasks is None else self.tasks
        if not names:
            raise UsageError("kind.tasks is empty; name some, or leave it out for all")
        return names

    def _drive(
        self, twin: Environment, expert: Actor, task: Task, rng: np.random.Generator, max_steps: int
    ) -> str | None:
        """Let the expert do the task in a copy of the world; why it does not count, or None."""
        start = _achieved(twin)
        command = task.command(start, rng)
        done = _DoneAndAtRest(task.judge, start, command, self.rest, round(self.rest_seconds * twin.spec.fps))
        goal = Goal(achieved=np.asarray(command, dtype=np.float32))
        outcome = rollout(
            [twin], expert, [goal], seeds=[int(rng.integers(2**31))], max_steps=max_steps, stop=done.stop
        )[0]
        final = outcome.final.achieved
        if not done.content:
            return f"it did not come to rest in {outcome.steps} steps ({outcome.ended})"
        # The policy is judged against what was reached, not against what was commanded.
        if not task.judge(start, final, final):
            return "what it reached would not be judged a success"
        if task.judge(start, start, final):
            return "nothing had to be done"
        return None


class _DoneAndAtRest:
    """Ends the expert's demonstration once the judge is content and nothing moves any more."""

    def __init__(self, judge: Judge, start: Array, command: Array, rest: float, steps: int) -> None:
        self._judge, self._start, self._command, self._rest = judge, start, command, rest
        self._recent: deque[Array] = deque(maxlen=max(1, steps) + 1)
        self.content = False

    def stop(self, _: int, observation: Observation) -> bool:
        self._recent.append(np.array(observation.achieved))
        if len(self._recent) < (self._recent.maxlen or 0):
            return False
        moved = np.ptp(np.stack(self._recent), axis=0).max()
        self.content = bool(moved <= self._rest) and self._judge(self._start, observation.achieved, self._command)
        return self.content


def _achieved(environment: Environment) -> Array:
    return np.array(environment.observe().achieved, dtype=np.float32)
