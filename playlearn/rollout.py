"""One actor, K environments in lockstep, one goal each -> K outcomes; the only loop that steps an environment.

Lockstep lets a policy plan for many environments in one batch. What happens in one environment depends only on its own
state, goal and seed, never on which of the others are still running.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from playlearn.config import to_dict, versions
from playlearn.episode import Array, Decision, Episode, EpisodeMeta, Goal, Observation
from playlearn.errors import ActionError, SimulationDiverged
from playlearn.sim.environment import Actor, Environment

__all__ = ["LENGTH", "STOPPED", "Actor", "Outcome", "RandomActor", "rollout"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """How one environment's rollout went.

    episode: what was recorded, None where it ended before the first action.
    ended: "length", "stopped" (by `stop`), what `Environment.failure` returned, "diverged: ..." or "refused: ..." (an
        invalid action).
    steps: actions executed.
    final: the last observation of a sound environment.
    """

    episode: Episode | None
    ended: str
    steps: int
    final: Observation


LENGTH = "length"
STOPPED = "stopped"


def rollout(
    environments: Sequence[Environment],
    actor: Actor,
    goals: Sequence[Goal | None],
    *,
    seeds: Sequence[int],
    max_steps: int,
    stop: Callable[[int, Observation], bool] | None = None,
    cameras: Sequence[str] = (),
) -> list[Outcome]:
    """Let `actor` drive every environment from the state it is in, each until it ends.

    An environment ends when it fails (`Environment.failure`), diverges, refuses an action, when
    `stop(k, observation)` returns True (called after every step), or after `max_steps`.

    goals: K goals; None for actors that need no goal.
    seeds: K seeds, of the actor's randomness.
    cameras: what the episodes record. The actor's own cameras are rendered without being kept, each at most once a
        step. Simulator states are always recorded, so any other image can be rendered later.

    Returns K outcomes, in the order of the environments.
    """
    if not len(environments) == len(goals) == len(seeds):
        raise ValueError(f"{len(environments)} environments, {len(goals)} goals and {len(seeds)} seeds")
    actor.reset(goals, seeds)
    seen = tuple(dict.fromkeys((*cameras, *actor.cameras)))
    takes = [_Take(environment, environment.observe(seen), tuple(cameras)) for environment in environments]
    for take in takes:
        take.ended = take.environment.failure()
    for step in range(1, max_steps + 1):
        active = [take.ended is None for take in takes]
        if not any(active):
            break
        decisions = actor.act([take.latest for take in takes], active)
        seen = tuple(dict.fromkeys((*cameras, *actor.cameras)))
        for k, (take, decision) in enumerate(zip(takes, decisions, strict=True)):
            if active[k]:
                take.ended = _step(take, decision, seen)
                if take.ended is None and stop is not None and stop(k, take.latest):
                    take.ended = STOPPED
        if step == max_steps:
            break
    packages = versions()
    return [take.outcome(actor.name, int(seed), packages) for take, seed in zip(takes, seeds, strict=True)]


def _step(take: "_Take", decision: Decision, cameras: Sequence[str]) -> str | None:
    """One control period of one environment; why it ended, or None."""
    action = np.array(decision.action, dtype=np.float32)  # as it is recorded, so that the recording replays exactly
    try:
        take.environment.step(action)
        observation = take.environment.observe(cameras)
    except SimulationDiverged as error:
        return f"diverged: {error}"
    except ActionError as error:
        return f"refused: {error}"
    take.record(action, decision, observation)
    return take.environment.failure()


@dataclass
class _Take:
    """The recording of one environment while it runs."""

    environment: Environment
    latest: Observation
    cameras: tuple[str, ...]
    ended: str | None = None
    decisions: list[Decision] = field(default_factory=list)
    observations: list[Observation] = field(default_factory=list)
    sim_states: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._keep(self.latest)

    def record(self, action: Array, decision: Decision, observation: Observation) -> None:
        label = action if decision.label is None else np.array(decision.label, dtype=np.float32)
        self.decisions.append(Decision(action, label, decision.skill, decision.intervention))
        self.latest = observation
        self._keep(observation)

    def _keep(self, observation: Observation) -> None:
        # Copies: an environment may return views of arrays that its next step overwrites.
        images = {camera: np.array(observation.images[camera]) for camera in self.cameras}
        state = np.array(observation.state, dtype=np.float32)
        achieved = np.array(observation.achieved, dtype=np.float32)
        self.observations.append(Observation(state, achieved, images, observation.time))
        self.sim_states.append(np.array(self.environment.sim_state(), dtype=np.float64))

    def outcome(self, actor: str, seed: int, packages: dict[str, str]) -> Outcome:
        ended = self.ended or LENGTH
        steps = len(self.decisions)
        episode = self._episode(actor, seed, packages, ended) if steps else None
        return Outcome(episode=episode, ended=ended, steps=steps, final=self.latest)

    def _episode(self, actor: str, seed: int, packages: dict[str, str], ended: str) -> Episode:
        spec, config = self.environment.spec, self.environment.config
        skills = tuple(sorted({decision.skill for decision in self.decisions}))
        sizes = {camera: self.observations[0].images[camera].shape[:2] for camera in self.cameras}
        meta = EpisodeMeta(
            environment=to_dict(config),
            state_names=tuple(spec.state_names),
            achieved_names=tuple(spec.achieved_names),
            action_names=tuple(spec.action_names),
            fps=spec.fps,
            seed=seed,
            actor=actor,
            skills=skills,
            controller=dict(spec.controller),
            cameras={camera: {"height": int(h), "width": int(w)} for camera, (h, w) in sizes.items()},
            renderer=self.environment.renderer() if self.cameras else "",
            versions=packages,
            ended=ended,
            quantities=spec.quantities,
        )
        return Episode(
            meta=meta,
            state=np.stack([observation.state for observation in self.observations]),
            achieved=np.stack([observation.achieved for observation in self.observations]),
            sim_state=np.stack(self.sim_states),
            time=np.array([observation.time for observation in self.observations], dtype=np.float64),
            action=np.stack([decision.action for decision in self.decisions]),
            expert_action=np.stack([np.asarray(decision.label) for decision in self.decisions]),
            intervention=np.array([decision.intervention for decision in self.decisions], dtype=np.bool_),
            skill=np.array([skills.index(decision.skill) for decision in self.decisions], dtype=np.int16),
            images={camera: np.stack([o.images[camera] for o in self.observations]) for camera in self.cameras},
        )


class RandomActor:
    """A random policy: every action dimension is an AR(1) process with std `scale`, clipped to [-1, 1].

    smoothness: correlation of consecutive actions, so that the arm wanders instead of jittering in place.
    """

    name = "random"
    cameras: tuple[str, ...] = ()

    def __init__(self, actions: int, scale: float = 0.6, smoothness: float = 0.9) -> None:
        self._actions = actions
        self._scale = scale
        self._smoothness = smoothness
        self._rngs: list[np.random.Generator] = []
        self._noise: list[Array] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._rngs = [np.random.default_rng(seed) for seed in seeds]
        self._noise = [self._scale * rng.standard_normal(self._actions) for rng in self._rngs]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        for k, running in enumerate(active):
            if running:
                fresh = self._scale * self._rngs[k].standard_normal(self._actions)
                self._noise[k] = self._smoothness * self._noise[k] + np.sqrt(1 - self._smoothness**2) * fresh
        return [Decision(np.clip(noise, -1.0, 1.0).astype(np.float32)) for noise in self._noise]
