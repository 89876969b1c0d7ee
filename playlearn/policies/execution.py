"""Chunk execution: a policy plans H actions at once, a few are executed, then it plans again."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from playlearn.batch import Inputs
from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import UsageError
from playlearn.picture import check_picture
from playlearn.policies.policy import Policy
from playlearn.quantity import Bounds, within


@dataclass
class _Row:
    """What is remembered of one environment.

    goal: what is to be reached.
    generator: of the noise of its plans.
    history: the observations at which it planned, or every one where the policy reads a history.
    plans: (step planned at, chunk (H, A)), newest last.
    moment: the present step.
    planned: how many plans there were.
    rng_state: generator state before the latest draw; restored to reuse the same noise.
    running: whether it still acts.
    """

    goal: Goal
    generator: torch.Generator
    history: deque[Observation]
    plans: list[tuple[int, Array]] = field(default_factory=list)
    moment: int = -1
    planned: int = 0
    rng_state: Tensor | None = None
    running: bool = True

    def due(self, n_action_steps: int) -> bool:
        """Whether the next step, `moment + 1`, needs a new plan."""
        return self.running and (not self.plans or self.moment + 1 - self.plans[-1][0] >= n_action_steps)

    def ready(self, noise_repeat: int) -> torch.Generator:
        """The generator for the next plan; of `noise_repeat` plans in a row, all draw the same noise."""
        if self.rng_state is None or self.planned % noise_repeat == 0:
            self.rng_state = self.generator.get_state()
        else:
            self.generator.set_state(self.rng_state)
        self.planned += 1
        return self.generator


class PolicyActor:
    """Acts in K environments with one policy (a rollout's Actor).

    policy: what predicts the chunks.
    n_action_steps: actions of a chunk that are executed before the next plan (receding horizon).
    guidance: weight of the goal, see `Policy.act`.
    ensemble: None, or the rate m of temporal ensembling: a plan at every step, and all plans for a step averaged with
        weight exp(-m i), i = 0 for the oldest (Zhao et al. 2023); `n_action_steps` is then 1.
    name: of the actor, in messages and results.
    goal: whether it reads goal states or goal images, for a policy that reads either (None: the policy's first choice).
    bounds: (A,) what the environment bounds its actions by, to which they are clipped; the play that the policy learned
        from may have known none.

    The actions in one environment do not depend on the others: each has its own generator, and a plan is always
    computed for all K rows, so that the arithmetic of a row is the same.
    """

    def __init__(
        self,
        policy: Policy,
        n_action_steps: int = 4,
        guidance: float | None = None,
        ensemble: float | None = None,
        name: str = "policy",
        goal: str | None = None,
        bounds: Bounds = (),
    ) -> None:
        chunk = policy.config.chunk
        if not 1 <= n_action_steps <= chunk:
            raise UsageError(
                f"n_action_steps must be between 1 and the policy's chunk of {chunk}, got {n_action_steps}"
            )
        self.name, self._bounds = name, bounds
        self.policy = policy.eval()
        self.n_action_steps = n_action_steps if ensemble is None else 1
        self.guidance, self.ensemble = guidance, ensemble
        encoder = policy.config.encoder
        self.reads = encoder.goals[0] if goal is None else goal
        if self.reads not in encoder.goals:
            raise UsageError(f"{name} reads its goal from {' or '.join(encoder.goals)}, not from {self.reads}")
        self._goal_cameras = encoder.goal_cameras if self.reads == "image" else ()
        self._rows: list[_Row] = []

    @property
    def cameras(self) -> tuple[str, ...]:
        """None while it only executes its plan, unless the policy reads a history."""
        looks = self._remembers or not self._rows or any(row.due(self.n_action_steps) for row in self._rows)
        return self.policy.cameras if looks else ()

    @property
    def _remembers(self) -> bool:
        return self.policy.config.history > 1

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        """Begin K episodes; forgets the ones before.

        Raises:
            UsageError: a goal is missing, lacks the image or the robot's state that the policy reads, or its image is
                of another size or kind.
        """
        for goal in goals:
            for camera in self._goal_cameras:
                if goal is None or camera not in goal.images:
                    raise UsageError(f"{self.name} reads its goal from a {camera!r} image, and there is none")
                size = self.policy.spec.cameras[camera]
                check_picture(goal.images[camera], size, f"the goal image of {camera!r} for {self.name}")
            if goal is None:
                raise UsageError(f"{self.name} needs a goal")
            if goal.state is None and self.policy.config.encoder.uses_goal_proprio:
                raise UsageError(
                    f"{self.name} was trained on goals with the robot's state (goal_proprio), and this goal has none"
                )
        steps = self.policy.config.history
        self._rows = [
            _Row(goal, torch.Generator().manual_seed(seed), deque(maxlen=steps))
            for goal, seed in zip(goals, seeds, strict=True)
            if goal is not None
        ]

    def show(self, row: int, goal: Goal) -> None:
        """Change the goal of one environment, in the middle of its episode; the next step plans for it."""
        self._rows[row].goal = goal
        self._rows[row].plans = []

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        """One decision an environment; those of inactive ones mean nothing."""
        due = []
        for row, observation, running in zip(self._rows, observations, active, strict=True):
            row.running = running
            if not running and row.history:
                continue
            plans = row.due(self.n_action_steps)
            row.moment += 1
            if plans:
                due.append(row)
            if plans or self._remembers or not row.history:  # else its images may be missing
                row.history.append(observation)
        if due:
            self._plan(due)
        return [Decision(action=within(self._action(row), self._bounds)) for row in self._rows]

    def std(self, samples: int, generators: Sequence[torch.Generator]) -> Array:
        """(K,) the standard deviation of chunks sampled for the last observations: how uncertain the policy is.

        The mean over the actions that would be executed; 0 for a deterministic head.

        samples: chunks of each environment.
        generators: one an environment, other than those that it acts by.
        """
        inputs = self._inputs()
        chunks = np.stack([self.policy.act(inputs, generators, self.guidance).numpy() for _ in range(samples)])
        std: Array = chunks[:, :, : self.n_action_steps].std(axis=0).mean(axis=(1, 2))  # (K,)
        return std

    def _plan(self, due: list[_Row]) -> None:
        # a row that is not due must not draw noise from its own generator
        spare = torch.Generator()
        noise_repeat = self.policy.head.noise_repeat
        generators = [row.ready(noise_repeat) if row in due else spare for row in self._rows]
        chunks = self.policy.act(self._inputs(), generators, self.guidance).numpy()
        for row, chunk in zip(self._rows, chunks, strict=True):
            if row in due:
                row.plans.append((row.moment, chunk))
                row.plans = [plan for plan in row.plans if row.moment - plan[0] < len(chunk)]

    def _action(self, row: _Row) -> Array:
        if not row.plans:
            return np.zeros(len(self.policy.spec.action_names), np.float32)
        if self.ensemble is None:
            planned, chunk = row.plans[-1]
            action: Array = chunk[min(row.moment - planned, len(chunk) - 1)]
            return action
        candidates = np.stack([chunk[row.moment - planned] for planned, chunk in row.plans])
        weights = np.exp(-self.ensemble * np.arange(len(candidates)))
        mean: Array = (weights[:, None] * candidates).sum(0) / weights.sum()
        return mean.astype(np.float32)

    def estimate_achieved(self, observations: Sequence[Observation], active: Sequence[bool]) -> Array:
        """(K, G) what is achieved in each environment, see `Policy.estimate_achieved`; of inactive ones, no meaning."""
        rows = zip(self._rows, observations, active, strict=True)
        seen = [[now] if running or not row.history else [row.history[-1]] for row, now, running in rows]
        achieved: Array = self.policy.estimate_achieved(self._inputs(seen)).numpy()
        return achieved

    def _inputs(self, histories: Sequence[Sequence[Observation]] | None = None) -> Inputs:
        """histories: of each environment, newest last (None: what was seen since the reset)."""
        encoder, steps = self.policy.config.encoder, self.policy.config.history
        seen = [list(row.history) for row in self._rows] if histories is None else histories
        padded = [[history[0]] * (steps - len(history)) + list(history) for history in seen]
        moments = [observation for history in padded for observation in history]
        goals = [row.goal for row in self._rows]

        def stack(values: list[Array]) -> Tensor:
            rows: Tensor = torch.from_numpy(np.stack(values))
            return rows.view(len(goals), steps, *rows.shape[1:])

        return Inputs(
            state=stack([o.state for o in moments]),
            achieved=stack([o.achieved for o in moments]),
            history_mask=torch.tensor([[False] * (steps - len(history)) + [True] * len(history) for history in seen]),
            goal_achieved=torch.from_numpy(np.stack([goal.achieved for goal in goals])),
            goal_proprio=torch.from_numpy(
                np.stack([o[-1].state if g.state is None else g.state for o, g in zip(padded, goals, strict=True)])
            ),
            images={c: stack([o.images[c] for o in moments]) for c in encoder.observation_cameras},
            goal_images={c: torch.from_numpy(np.stack([g.images[c] for g in goals])) for c in self._goal_cameras},
        )
