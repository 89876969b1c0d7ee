"""Make goals: the expert does named tasks, one or several in a row, and the goal is the state that it reached."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from playlearn.config.schema import nearest
from playlearn.episode import Array, Goal, Observation
from playlearn.errors import UsageError
from playlearn.evaluation.suite import ChainGoal, Judge, goal_from
from playlearn.rollout import Actor, rollout
from playlearn.sim.environment import Environment, Task

DRAWS = 20  # of an episode's start state before it is given up
TRIES = 5  # tasks to try as the next one of a sequence


@dataclass(frozen=True)
class GoalGeneration:
    """Criterion for a settled goal: no dimension of `achieved` moves more than `rest` for `seconds`."""

    rest: float
    seconds: float

    def drive(
        self, copy: Environment, expert: Actor, task: Task, rng: np.random.Generator, max_steps: int
    ) -> str | None:
        """Let the expert do the task in a copy of the environment; the reason if it fails, else None."""
        start = achieved_now(copy)
        command = task.command(start, rng)
        settled = _SettledSuccess(task.judge, start, command, self.rest, round(self.seconds * copy.spec.fps))
        goal = Goal(achieved=np.asarray(command, dtype=np.float32))
        outcome = rollout(
            [copy], expert, [goal], seeds=[int(rng.integers(2**31))], max_steps=max_steps, stop=settled.stop
        )[0]
        final = outcome.final.achieved
        if not settled.success:
            return f"it did not come to rest in {outcome.steps} steps ({outcome.ended})"
        # The policy is evaluated on the state that the expert reached, not on the command.
        if not task.judge(start, final, final):
            return "the state that it reached is no success"
        if task.judge(start, start, final):
            return "nothing had to be done"
        return None

    def sequence(
        self,
        copy: Environment,
        expert: Actor,
        names: Sequence[str],
        length: int,
        rng: np.random.Generator,
        max_steps: int,
        cameras: Sequence[str],
    ) -> list[ChainGoal]:
        """Up to `length` tasks that the expert did in a copy of the environment, each from the end of the previous one.

        Each is drawn from the possible tasks of the kinds used least so far, as CALVIN draws its sequences. None
        leads back to an earlier state. There are fewer if the expert cannot go on.
        """
        goals: list[ChainGoal] = []
        used: Counter[str] = Counter()
        visited = [achieved_now(copy)]
        while len(goals) < length:
            possible = [name for name in names if copy.tasks[name].precondition(visited[-1])]
            drawn = [possible[i] for i in rng.permutation(len(possible))]
            drawn.sort(key=lambda name: used[copy.tasks[name].kind])
            saved = np.array(copy.sim_state())
            for name in drawn[:TRIES]:
                task = copy.tasks[name]
                failure = self.drive(copy, expert, task, rng, max_steps)
                now = achieved_now(copy)
                if failure is None and not any(copy.reached(now, earlier) for earlier in visited):
                    goals.append(ChainGoal(name, goal_from(copy, cameras), np.array(copy.sim_state())))
                    used[task.kind] += 1
                    visited.append(now)
                    break
                copy.set_state(saved)
            else:
                break
        return goals


def start_states(
    environment: Environment, seed: int, episode: int
) -> Iterator[tuple[int, np.random.Generator, Array, Array]]:
    """Valid start states of an episode, in turn: number of the draw, its generator, sim state, achieved (G,)."""
    for draw in range(DRAWS):
        rng = np.random.default_rng((seed, episode, draw))
        environment.reset(int(rng.integers(2**31)))
        if environment.failure() is None:
            yield draw, rng, np.array(environment.sim_state()), achieved_now(environment)


def names_of(environment: Environment, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """The tasks of a suite: those wanted, or all; raises UsageError if the environment lacks one."""
    known = tuple(environment.tasks)
    for name in wanted or ():
        if name not in known:
            raise UsageError(f"kind.tasks: this environment has no task {name!r}{nearest(name, known)}")
    names = known if wanted is None else tuple(wanted)
    if not names:
        raise UsageError("kind.tasks is empty; name some, or leave it out for all")
    return names


def achieved_now(environment: Environment) -> Array:
    """(G,) float32, a copy."""
    return np.array(environment.observe().achieved, dtype=np.float32)


class _SettledSuccess:
    """Ends the expert's demonstration once the judge is satisfied and nothing moves any more."""

    def __init__(self, judge: Judge, start: Array, command: Array, rest: float, steps: int) -> None:
        self._judge, self._start, self._command, self._rest = judge, start, command, rest
        self._recent: deque[Array] = deque(maxlen=max(1, steps) + 1)
        self.success = False

    def stop(self, _: int, observation: Observation) -> bool:
        self._recent.append(np.array(observation.achieved))
        if len(self._recent) < (self._recent.maxlen or 0):
            return False
        moved = np.ptp(np.stack(self._recent), axis=0).max()
        self.success = bool(moved <= self._rest) and self._judge(self._start, observation.achieved, self._command)
        return self.success
