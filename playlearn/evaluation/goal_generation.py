"""What goals are made from: the expert does named tasks, one or several in a row, and is seen to have done them."""

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
TRIES = 5  # of another task, where the expert did not do one that would have come next


@dataclass(frozen=True)
class GoalGeneration:
    """rest, seconds: a goal counts as reached by the expert once nothing of `achieved` moved more for so long."""

    rest: float
    seconds: float

    def drive(
        self, twin: Environment, expert: Actor, task: Task, rng: np.random.Generator, max_steps: int
    ) -> str | None:
        """Let the expert do the task in a copy of the world; why it does not count, or None."""
        start = achieved_now(twin)
        command = task.command(start, rng)
        done = _DoneAndAtRest(task.judge, start, command, self.rest, round(self.seconds * twin.spec.fps))
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

    def sequence(
        self,
        twin: Environment,
        expert: Actor,
        names: Sequence[str],
        length: int,
        rng: np.random.Generator,
        max_steps: int,
        cameras: Sequence[str],
    ) -> list[ChainGoal]:
        """Up to `length` tasks that the expert did in a copy of the world, each from where the one before had ended.

        Each is drawn from those that are possible then, of the kinds used least so far, as CALVIN draws its
        sequences. None leads back to where the world had been. Fewer come where the expert finds no way on.
        """
        links: list[ChainGoal] = []
        used: Counter[str] = Counter()
        been = [achieved_now(twin)]
        while len(links) < length:
            possible = [name for name in names if twin.tasks[name].precondition(been[-1])]
            drawn = [possible[i] for i in rng.permutation(len(possible))]
            drawn.sort(key=lambda name: used[twin.tasks[name].kind])
            here = np.array(twin.sim_state())
            for name in drawn[:TRIES]:
                task = twin.tasks[name]
                undone = self.drive(twin, expert, task, rng, max_steps)
                now = achieved_now(twin)
                if undone is None and not any(twin.reached(now, before) for before in been):
                    links.append(ChainGoal(name, goal_from(twin, cameras), np.array(twin.sim_state())))
                    used[task.kind] += 1
                    been.append(now)
                    break
                twin.set_state(here)
            else:
                break
        return links


def beginnings(
    environment: Environment, seed: int, episode: int
) -> Iterator[tuple[int, np.random.Generator, Array, Array]]:
    """Sound start states of an episode, to be tried in turn: which draw, its generator, sim state, achieved (G,)."""
    for draw in range(DRAWS):
        rng = np.random.default_rng((seed, episode, draw))
        environment.reset(int(rng.integers(2**31)))
        if environment.failure() is None:
            yield draw, rng, np.array(environment.sim_state()), achieved_now(environment)


def names_of(environment: Environment, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """The tasks of a suite: those wanted, or all; raises UsageError where the environment lacks one."""
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
