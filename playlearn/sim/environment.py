"""What every environment offers; rollouts, evaluation and collection use nothing else of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, runtime_checkable

import draccus
import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.quantity import Quantities


@dataclass(frozen=True)
class CameraConfig:
    """Size of the recorded images, in pixels."""

    height: int = 64
    width: int = 64


@dataclass(frozen=True)
class Task:
    """A named task: where it starts, what to ask an expert for, and what counts as success.

    name: unique in its environment.
    kind: what it is an instance of (`lift` of `lift_red`), for play's weights.
    precondition: (achieved) -> bool, whether a start state suits the task.
    arrange: (environment, rng) -> None, brings a freshly reset environment into such a state.
    command: (achieved, rng) -> (G,), the goal state an expert is asked to reach from there.
    judge: (start, achieved, goal) -> bool, success at what the task names, and nothing else.
    pose: (environment, rng) -> (N,) simulator state of the goal, which a benchmark's task gives instead of having an
        expert reach it; brings the environment into a start state.
    """

    name: str
    kind: str
    precondition: Callable[[Array], bool]
    arrange: Callable[[Any, np.random.Generator], None]
    command: Callable[[Array, np.random.Generator], Array]
    judge: Callable[[Array, Array, Array], bool]
    pose: Callable[[Any, np.random.Generator], Array] | None = None


@dataclass(frozen=True)
class EnvironmentSpec:
    """What an environment's numbers mean.

    state_names: of `observation.state`.
    achieved_names: of the achieved goal.
    action_names: of an action.
    cameras: that can be rendered.
    fps: control steps a second.
    controller: its type, gains and limits, on record.
    quantities: what the dimensions of `state` and `achieved` measure, and what bounds the actions.
    """

    state_names: tuple[str, ...]
    achieved_names: tuple[str, ...]
    action_names: tuple[str, ...]
    cameras: tuple[str, ...]
    fps: float
    controller: Mapping[str, Any] = field(default_factory=dict)
    quantities: Quantities = field(default_factory=Quantities)


@dataclass(frozen=True)
class EnvironmentConfig(draccus.ChoiceRegistry):
    """The base of every environment's config; `type:` in a YAML picks the kind."""

    def build(self) -> "Environment":
        raise NotImplementedError


class Environment(Protocol):
    """One simulated environment. Not thread-safe; one process may hold many.

    config: builds it again.
    spec: names its indices.
    tasks: its named tasks.
    """

    spec: EnvironmentSpec
    tasks: Mapping[str, Task]

    @property
    def config(self) -> EnvironmentConfig: ...

    def reset(self, seed: int) -> None:
        """Draw a random, collision-free start state; the same seed gives the same one."""
        ...

    def clone(self) -> Self:
        """A second environment over the same model and renderer, in the same state (cheap)."""
        ...

    def sim_state(self) -> Array:
        """(N,) float64: everything that `set_state` needs to go on exactly as this environment would."""
        ...

    def set_state(self, sim_state: Array) -> None: ...

    def step(self, action: Array) -> None:
        """Execute (A,) in [-1, 1] for one control period.

        Raises:
            ActionError: not finite, wrong shape or out of range (the environment is left untouched).
            SimulationDiverged: physics broke; the environment is unusable until reset or set_state.
        """
        ...

    def observe(self, cameras: Sequence[str] = ()) -> Observation: ...

    def failure(self) -> str | None:
        """Why this episode cannot go on (a block fell off the table), else None."""
        ...

    def reached(self, achieved: Array, goal: Array) -> bool:
        """Whether everything is where the goal shows it, within the environment's tolerances."""
        ...

    def render(self, camera: str, height: int | None = None, width: int | None = None) -> Array:
        """(h, w, 3) uint8, upright; by default in the size that the config names."""
        ...

    def renderer(self) -> str:
        """GL back end and device, for the record."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class Parkable(Protocol):
    """An environment that can put its robot elsewhere."""

    def park(self, home: Array) -> None:
        """Put the robot where it is in another simulator state, and leave all else as it is."""
        ...


class Actor(Protocol):
    """What acts: a policy, the scripted expert, a play policy, a teleoperator, random actions.

    name: on record.
    cameras: whose images it needs when it acts next; asked after every `reset` and `act`, since rendering is
        expensive and a policy need not look while it carries out a plan.
    """

    @property
    def name(self) -> str: ...

    @property
    def cameras(self) -> tuple[str, ...]: ...

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        """Begin with K environments; everything random in row k comes from seeds[k]."""
        ...

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> Sequence[Decision]:
        """One decision for each of the K environments; those of inactive ones are not read."""
        ...
