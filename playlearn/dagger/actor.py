"""Policy and expert share control: who acts is drawn or gated; the label is always the expert's action."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from playlearn.dagger.gate import Gate, GateConfig, GateSignal
from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.privileges import LABELED_BY_EXPERT
from playlearn.rollout import Actor

StdOf = Callable[[int, Sequence[torch.Generator]], Array]


@dataclass(frozen=True)
class InterventionRule:
    """Who acts when.

    beta: probability that a stretch of `switch_every` steps is the expert's.
    switch_every: steps of a stretch.
    gate: when else the expert takes over.
    steps: range from which each environment draws after how many steps the expert takes over to reach the goal.
    plans: steps between two plans of the policy. Only there it gets control back, so that it never executes a plan
        made before the expert acted.
    """

    beta: float
    switch_every: int
    gate: GateConfig
    steps: tuple[int, int]
    plans: int = 1


@dataclass(eq=False)
class _Row:
    """What belongs to one environment. until: the step at which the expert takes over for good."""

    rng: np.random.Generator
    sampling: torch.Generator
    gate: Gate
    until: int
    drawn: bool = False
    expert_acts: bool = False

    def expert_takes(self, step: int, signal: GateSignal, rule: InterventionRule) -> bool:
        """Whether the expert acts at this step."""
        if step % rule.switch_every == 0:
            self.drawn = bool(self.rng.random() < rule.beta)
        wanted = self.gate(signal) or self.drawn or step >= self.until
        self.expert_acts = wanted or (self.expert_acts and step % rule.plans != 0)
        return self.expert_acts


class DaggerActor:
    """An Actor that asks policy and expert; what it draws for an environment comes from that environment's seed."""

    name = LABELED_BY_EXPERT

    def __init__(self, policy: Actor, expert: Actor, rule: InterventionRule, std: StdOf | None = None) -> None:
        """std: see `PolicyActor.std`; needed by gates that measure how uncertain the policy is."""
        self._policy, self._expert, self._rule, self._std = policy, expert, rule, std
        self._rows: list[_Row] = []
        self._step = 0
        self._stds: Array = np.zeros(0)

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self._policy.cameras, *self._expert.cameras)))

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._policy.reset(goals, seeds)
        self._expert.reset(goals, seeds)
        self._rows, self._step, self._stds = [self._row(seed) for seed in seeds], 0, np.zeros(len(seeds))

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        chosen, labels = self._policy.act(observations, active), self._expert.act(observations, active)
        if self._rule.gate.sampled and self._step % self._rule.plans == 0:
            self._stds = self._measured()
        decisions = []
        for row, mine, its, std in zip(self._rows, chosen, labels, self._stds, strict=True):
            label = np.asarray(its.action, np.float32)
            signal = GateSignal(float(np.abs(np.asarray(mine.action) - label).max()), float(std))
            expert_acts = row.expert_takes(self._step, signal, self._rule)
            decisions.append(
                Decision(label if expert_acts else mine.action, label, its.skill, intervention=expert_acts)
            )
        self._step += 1
        return decisions

    def unsure(self) -> bool:
        """Whether the policy's samples differed at all when they were last compared."""
        return bool(self._stds.any())

    def _row(self, seed: int) -> _Row:
        rng = np.random.default_rng((seed, 1))  # not the numbers that policy and expert draw from this seed
        until = int(rng.integers(*self._rule.steps, endpoint=True))
        sampling = torch.Generator().manual_seed(int(rng.integers(2**63)))
        return _Row(rng, sampling, self._rule.gate.build(), until)

    def _measured(self) -> Array:
        if self._std is None:
            raise ValueError("a gate that measures how uncertain the policy is needs `std`")
        return self._std(self._rule.gate.sampled, [row.sampling for row in self._rows])
