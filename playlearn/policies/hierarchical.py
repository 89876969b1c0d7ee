"""Distant goals through subgoals: a high-level policy proposes the next change, a low-level policy executes it.

The high-level policy is a policy like any other, trained with `data.target: next_settled_delta` on goals several
settled moments ahead: from the distant goal and the observations it predicts the change of `achieved` up to the next
settled moment. Its head samples, since the order of changes is often a free choice. After HIQL (Park et al. 2023),
whose high-level policy proposes the state in k steps; the next settled moment is a more natural subgoal, and it stays
as it is until it is reached.

Proposals are off by 1 to 2 cm, so an object is snapped to its current or goal pose when the proposal lies within
`NEAR` of it. Where a proposal is reached already, the low-level policy gets the distant goal itself for one plan.
"""

from collections.abc import Callable, Sequence

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.policies.execution import PolicyActor
from playlearn.quantity import difference

NEAR = 0.3  # of a dimension's std in play: some 4 cm of a block's position on a table

Reached = Callable[[Array, Array], bool]  # (achieved, goal), each (G,)


class SubgoalActor:
    """Acts in K environments through subgoals (a rollout's Actor).

    low_level: acts, and reads goal states.
    high_level: predicts the next change.
    reached: whether a subgoal is reached, given what the low-level policy estimates as achieved.
    steps: for how many steps a subgoal is kept at most. Checked, as `reached` is, whenever the low-level policy plans.

    Raises:
        UsageError: the low-level policy reads goals with the robot's state, which subgoals lack.
    """

    def __init__(self, low_level: PolicyActor, high_level: PolicyActor, reached: Reached, steps: int) -> None:
        if low_level.policy.config.encoder.uses_goal_proprio:
            raise UsageError(
                f"{low_level.name} was trained on goals with the robot's state (goal_proprio), which subgoals lack"
            )
        self.name = low_level.name
        self._low, self._high, self._reached, self._steps = low_level, high_level, reached, steps
        self._moment = 0
        self._until: list[int] = []
        self._subgoals: list[Array | None] = []
        self._goals: Sequence[Goal | None] = ()
        self._objects = list(ObjectLayout(low_level.policy.spec.achieved_names).objects().values())
        self._declared = low_level.policy.spec.quantities.achieved
        self._std: Array = low_level.policy.normalizer.get_buffer("achieved_std").cpu().numpy()

    @property
    def cameras(self) -> tuple[str, ...]:
        """Those of both policies where a subgoal may be due, else what the low-level policy needs."""
        due = self._moment % self._low.n_action_steps == 0
        both = (*self._low.policy.cameras, *self._high.policy.cameras)
        return tuple(dict.fromkeys(both)) if due else self._low.cameras

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        """Begin K episodes; raises UsageError where a goal lacks what the high-level policy reads."""
        self._high.reset(goals, [_own_seed(seed) for seed in seeds])
        self._low.reset(goals, seeds)
        self._moment, self._goals = 0, goals
        self._until = [0] * len(goals)
        self._subgoals = [None] * len(goals)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        """One decision an environment; those of inactive ones mean nothing."""
        if self._moment % self._low.n_action_steps == 0:
            self._propose(observations, active)
        self._moment += 1
        return self._low.act(observations, active)

    def _propose(self, observations: Sequence[Observation], active: Sequence[bool]) -> None:
        achieved = self._low.estimate_achieved(observations, active)
        due = [
            running and (subgoal is None or self._moment >= until or self._reached(now, subgoal))
            for running, subgoal, until, now in zip(active, self._subgoals, self._until, achieved, strict=True)
        ]
        if not any(due):
            return
        changes = self._high.act(observations, due)
        for k in np.flatnonzero(due).tolist():
            goal, steps = self._goals[k], self._steps
            subgoal = self._snapped(k, achieved[k], (achieved[k] + changes[k].action).astype(np.float32))
            if goal is not None and self._high.reads == "state" and self._reached(achieved[k], subgoal):
                subgoal, steps = goal.achieved, self._low.n_action_steps
            self._subgoals[k], self._until[k] = subgoal, self._moment + steps
            self._low.show(k, Goal(subgoal))

    def _snapped(self, k: int, now: Array, proposed: Array) -> Array:
        """(G,) the proposal, each object snapped to its current or goal pose, whichever is nearer, if within `NEAR`."""
        goal = self._goals[k]
        poses = [now] if goal is None or self._high.reads == "image" else [now, goal.achieved]
        snapped = proposed.copy()
        for own in self._objects:
            off = [
                float(np.max(np.abs(difference(pose, proposed, self._declared))[own] / self._std[own]))
                for pose in poses
            ]
            nearest = int(np.argmin(off))
            if off[nearest] <= NEAR:
                snapped[own] = poses[nearest][own]
        return snapped


def _own_seed(seed: int) -> int:
    """A seed for the high-level policy, so that the low-level policy draws what it would draw alone."""
    return int(np.random.SeedSequence((seed, 1)).generate_state(1)[0])
