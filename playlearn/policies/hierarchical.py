"""Far goals step by step: a proposer says how the world will differ next, a policy below it brings that about.

The proposer is a policy like any other, trained with `data.target: change` on goals several settled moments ahead: of
the far goal and what is seen it makes the change up to the next settled moment. Its head samples, since what
is to be done first is often a free choice. After HIQL (Park et al. 2023), whose upper level proposes where to be in k
steps; the next settled moment is what people would call the next step, and it holds still to be reached.

What it proposes is a centimeter or two off. So of each thing that it proposes to leave about where it is, or to bring
about where the far goal has it, exactly that is asked. And where it proposes nothing that is not so already, the worker
is shown the far goal itself for one plan.
"""

from collections.abc import Callable, Sequence

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.policies.execution import PolicyActor

NEAR = 0.3  # of a dimension's spread in play: some 4 cm of a block's place on a table

Reached = Callable[[Array, Array], bool]  # (achieved, goal), each (G,)


class SubgoalActor:
    """Acts in K environments through subgoals (a rollout's Actor).

    worker: acts, and reads goals that are states. proposer: plans the next change. reached: when a subgoal is, by
        what the worker believes is achieved. steps: how long a subgoal stays at most. Both are looked at whenever the
        worker is to plan anew.

    Raises:
        UsageError: the worker was taught goals that say where the arm is, which no subgoal does.
    """

    def __init__(self, worker: PolicyActor, proposer: PolicyActor, reached: Reached, steps: int) -> None:
        if worker.policy.config.encoder.uses_goal_proprio:
            raise UsageError(
                f"{worker.name} was taught goals that say where the arm is (goal_proprio), and no subgoal does"
            )
        self.name = worker.name
        self._worker, self._proposer, self._reached, self._steps = worker, proposer, reached, steps
        self._moment = 0
        self._until: list[int] = []
        self._subgoals: list[Array | None] = []
        self._goals: Sequence[Goal | None] = ()
        self._objects = list(ObjectLayout(worker.policy.spec.achieved_names).objects().values())
        self._spread: Array = worker.policy.normalizer.get_buffer("achieved_std").cpu().numpy()

    @property
    def cameras(self) -> tuple[str, ...]:
        """All that either looks through where a subgoal may be due, else what the worker needs."""
        due = self._moment % self._worker.n_action_steps == 0
        both = (*self._worker.policy.cameras, *self._proposer.policy.cameras)
        return tuple(dict.fromkeys(both)) if due else self._worker.cameras

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        """Begin K episodes; raises UsageError where a goal lacks what the proposer reads."""
        self._proposer.reset(goals, [_apart(seed) for seed in seeds])
        self._worker.reset(goals, seeds)
        self._moment, self._goals = 0, goals
        self._until = [0] * len(goals)
        self._subgoals = [None] * len(goals)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        """One decision an environment; those of inactive ones mean nothing."""
        if self._moment % self._worker.n_action_steps == 0:
            self._propose(observations, active)
        self._moment += 1
        return self._worker.act(observations, active)

    def _propose(self, observations: Sequence[Observation], active: Sequence[bool]) -> None:
        estimate_achieved = self._worker.estimate_achieved(observations, active)
        due = [
            running and (subgoal is None or self._moment >= until or self._reached(now, subgoal))
            for running, subgoal, until, now in zip(active, self._subgoals, self._until, estimate_achieved, strict=True)
        ]
        if not any(due):
            return
        changes = self._proposer.act(observations, due)
        for k in np.flatnonzero(due).tolist():
            goal, steps = self._goals[k], self._steps
            subgoal = self._exact(
                k, estimate_achieved[k], (estimate_achieved[k] + changes[k].action).astype(np.float32)
            )
            if goal is not None and self._proposer.reads == "state" and self._reached(estimate_achieved[k], subgoal):
                subgoal, steps = goal.achieved, self._worker.n_action_steps
            self._subgoals[k], self._until[k] = subgoal, self._moment + steps
            self._worker.show(k, Goal(subgoal))

    def _exact(self, k: int, now: Array, proposed: Array) -> Array:
        """(G,) the proposal, each thing of it where it is or is to be, whichever is nearer, where that is near."""
        goal = self._goals[k]
        known = [now] if goal is None or self._proposer.reads == "image" else [now, goal.achieved]
        exact = proposed.copy()
        for own in self._objects:
            off = [float(np.max(np.abs(place - proposed)[own] / self._spread[own])) for place in known]
            nearest = int(np.argmin(off))
            if off[nearest] <= NEAR:
                exact[own] = known[nearest][own]
        return exact


def _apart(seed: int) -> int:
    """Luck of the proposer's own, so that the worker's is what it would be without it."""
    return int(np.random.SeedSequence((seed, 1)).generate_state(1)[0])
