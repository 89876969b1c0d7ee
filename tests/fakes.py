"""A tiny planar environment with everything that the Environment protocol asks for: quick, exact, drawable.

A gripper moves on the square [-1, 1]^2. While its grip is closed it drags the puck if that was within
`REACH` when it closed; closing it over the button switches the lamp. A puck beyond the edge fell off.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from playlearn.episode import Array, Decision, Goal, Observation
from playlearn.errors import ActionError, SimulationDiverged
from playlearn.quantity import Quantities
from playlearn.sim.environment import CameraConfig, Environment, EnvironmentConfig, EnvironmentSpec, Task

REACH = 0.12
STRIDE = 0.1
FPS = 10.0
BUTTON = np.array([0.0, 0.8])
TOLERANCE = 0.06


def _cameras() -> dict[str, CameraConfig]:
    return {"front": CameraConfig(24, 32), "wrist": CameraConfig(16, 16)}


@EnvironmentConfig.register_subclass("point")
@dataclass(frozen=True)
class PointConfig(EnvironmentConfig):
    """diverge_at: the step (since reset or set_state) at which physics breaks, never by default."""

    cameras: dict[str, CameraConfig] = field(default_factory=_cameras)
    diverge_at: int | None = None

    def build(self) -> Environment:
        return PointEnv(self)


class PointEnv:
    """sim state: time, hand x y, grip, puck x y, lamp, whether the puck is held."""

    spec = EnvironmentSpec(
        state_names=("hand.x", "hand.y", "grip"),
        achieved_names=("puck.x", "puck.y", "lamp"),
        action_names=("dx", "dy", "grip"),
        cameras=("front", "wrist"),
        fps=FPS,
        controller={"type": "VELOCITY"},
        quantities=Quantities(
            state=("length x", "length y", "plain grip"),
            achieved=("length x", "length y", "binary lamp"),
            action_bounds=((-1.0, 1.0),) * 3,
        ),
    )

    def __init__(self, config: PointConfig) -> None:
        self.config: EnvironmentConfig = config
        self._sizes, self._diverge_at = config.cameras, config.diverge_at
        self.tasks: Mapping[str, Task] = TASKS
        self.renders: list[str] = []
        self._steps = 0
        self._sim: Array = np.zeros(8)

    def reset(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.set_state(np.concatenate([[0.0], rng.uniform(-0.8, 0.8, 2), [0.0], rng.uniform(-0.6, 0.6, 2), [0, 0]]))

    def clone(self) -> Self:
        twin = copy(self)
        twin.renders = []
        twin.set_state(self._sim)
        return twin

    def sim_state(self) -> Array:
        return self._sim  # on purpose not a copy: a recorder must make its own

    def set_state(self, sim_state: Array) -> None:
        self._sim = np.array(sim_state, dtype=np.float64)
        self._steps = 0

    def step(self, action: Array) -> None:
        if action.shape != (3,) or not np.isfinite(action).all() or np.abs(action).max() > 1:
            raise ActionError(f"an action must be 3 finite numbers in [-1, 1], got {action}")
        self._steps += 1
        if self._steps == self._diverge_at:
            raise SimulationDiverged("the point left the plane")
        lamp, held = float(self._sim[6]), float(self._sim[7])
        hand = np.clip(self._sim[1:3] + STRIDE * action[:2], -1.2, 1.2)
        puck = self._sim[4:6].copy()
        closing = action[2] > 0 and self._sim[3] <= 0
        if closing and np.linalg.norm(hand - BUTTON) < REACH:
            lamp = 1.0 - lamp
        if closing:
            held = float(np.linalg.norm(hand - puck) < REACH)
        held = held if action[2] > 0 else 0.0
        if held:
            puck = hand.copy()
        self._sim[:] = [self._sim[0] + 1 / FPS, *hand, float(action[2] > 0), *puck, lamp, held]

    def observe(self, cameras: Sequence[str] = ()) -> Observation:
        return Observation(
            state=self._sim[1:4].astype(np.float32),
            achieved=self._sim[4:7].astype(np.float32),
            images={camera: self.render(camera) for camera in cameras},
            time=float(self._sim[0]),
        )

    def failure(self) -> str | None:
        return "the puck fell off the table" if np.abs(self._sim[4:6]).max() > 1 else None

    def reached(self, achieved: Array, goal: Array) -> bool:
        return bool(np.linalg.norm(achieved[:2] - goal[:2]) < TOLERANCE and abs(achieved[2] - goal[2]) < 0.5)

    def render(self, camera: str, height: int | None = None, width: int | None = None) -> Array:
        """The table gray, the hand black, the puck red, the lamp in the corner."""
        size = self._sizes[camera]
        height, width = height or size.height, width or size.width
        self.renders.append(camera)
        y, x = np.linspace(1.2, -1.2, height)[:, None], np.linspace(-1.2, 1.2, width)

        def disc(at: Array, radius: float) -> Array:
            inside: Array = (x - at[0]) ** 2 + (y - at[1]) ** 2 < radius**2
            return inside

        shown = np.zeros((height, width), np.intp)
        on_table, lamp = (np.abs(x) < 1) & (np.abs(y) < 1), (x > 0.9) & (y > 0.9)
        for color, where in enumerate((on_table, disc(self._sim[4:6], 0.15), disc(self._sim[1:3], 0.1), lamp), 1):
            np.copyto(shown, color, where=where)
        lit = (250, 220, 60) if self._sim[6] else (80, 80, 80)
        colors = [(235, 235, 235), (180, 180, 180), (200, 40, 40), (20, 20, 20), lit]
        image: Array = np.take(np.array(colors, np.uint8), shown, axis=0)
        return image

    def rearrange(self, rng: np.random.Generator) -> None:
        self._sim[4:6] = rng.uniform(-0.6, 0.6, 2)

    def project(self, camera: str, points: Array) -> Array:
        """As `render` lays out the plane."""
        return points[:, :2] * (1, -1) / 1.2

    def renderer(self) -> str:
        return "numpy"

    def close(self) -> None:
        pass


def _shift(environment: Environment, rng: np.random.Generator, lamp: float) -> None:
    state = np.array(environment.sim_state())
    state[6] = lamp
    environment.set_state(state)


def _move(achieved: Array, rng: np.random.Generator) -> Array:
    # Far enough from where it is, and well inside the edge.
    while True:
        target = rng.uniform(-0.7, 0.7, 2)
        if np.linalg.norm(target - achieved[:2]) > 0.4:
            return np.array([*target, achieved[2]], dtype=np.float32)


def _light(achieved: Array, rng: np.random.Generator) -> Array:
    return np.array([achieved[0], achieved[1], 1.0], dtype=np.float32)


TASKS: dict[str, Task] = {
    "move_puck": Task(
        name="move_puck",
        kind="move",
        precondition=lambda _achieved: True,
        arrange=lambda _environment, _rng: None,
        command=_move,
        judge=lambda _start, achieved, goal: bool(np.linalg.norm(achieved[:2] - goal[:2]) < 0.1),
    ),
    "lamp_on": Task(
        name="lamp_on",
        kind="lamp",
        precondition=lambda achieved: bool(achieved[2] < 0.5),
        arrange=lambda environment, rng: _shift(environment, rng, float(rng.random() < 0.5)),
        command=_light,
        judge=lambda _start, achieved, _goal: bool(achieved[2] > 0.5),
    ),
}


class PointExpert:
    """Closed loop: fetches the puck, brings it to its place, then presses the button if need be.

    fumble: the probability that an episode's expert does nothing at all.
    """

    name = "expert"
    cameras: tuple[str, ...] = ()

    def __init__(self, fumble: float = 0.0) -> None:
        self._fumble = fumble
        self._goals: list[Array] = []
        self._idle: list[bool] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._goals = [goal.achieved for goal in goals if goal is not None]
        self._idle = [bool(np.random.default_rng(seed).random() < self._fumble) for seed in seeds]

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        return [
            Decision(np.zeros(3, np.float32), skill="idle") if idle else _expert(observation, goal)
            for observation, goal, idle in zip(observations, self._goals, self._idle, strict=True)
        ]


def _expert(observation: Observation, goal: Array) -> Decision:
    hand, grip, puck = observation.state[:2], observation.state[2], observation.achieved[:2]
    if np.linalg.norm(puck - goal[:2]) > 0.02:
        if grip > 0 and np.linalg.norm(puck - hand) < 1e-3:
            return _towards(hand, goal[:2], 1.0, "carry")
        return _towards(hand, puck, float(np.linalg.norm(puck - hand) < 1e-3), "fetch")
    if abs(observation.achieved[2] - goal[2]) > 0.5:
        near = np.linalg.norm(hand - BUTTON) < 0.02
        return _towards(hand, BUTTON, float(near and grip <= 0), "press")
    return Decision(np.zeros(3, np.float32), skill="rest")


def _towards(hand: Array, target: Array, grip: float, skill: str) -> Decision:
    # A closed grip only where `grip` says so: -1 opens and 0 does too.
    delta = np.clip((target - hand) / STRIDE, -1, 1)
    return Decision(np.array([*delta, grip], dtype=np.float32), skill=skill)


class PointPlayPolicy:
    """Unstructured play: fetches the puck, drags it somewhere, at times presses the button; sees no goal."""

    name = "player"
    cameras: tuple[str, ...] = ()

    def __init__(self, noise: float = 0.0) -> None:
        self._noise = noise
        self._rngs: list[np.random.Generator] = []
        self._wishes: list[Array | None] = []
        self._patience: list[int] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        self._rngs = [np.random.default_rng(seed) for seed in seeds]
        self._wishes = [None] * len(self._rngs)
        self._patience = [0] * len(self._rngs)

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        return [self._decide(k, observation) for k, observation in enumerate(observations)]

    def _decide(self, k: int, observation: Observation) -> Decision:
        rng, wish = self._rngs[k], self._wishes[k]
        if wish is None or self._patience[k] <= 0:
            fresh = np.concatenate([rng.uniform(-0.7, 0.7, 2), [float(rng.random() < 0.5)]])
            wish = self._wishes[k] = fresh.astype(np.float32)
            self._patience[k] = int(rng.integers(25, 50))
        self._patience[k] -= 1
        decision = _expert(observation, wish)
        action = decision.action.copy()
        action[:2] = np.clip(action[:2] + self._noise * rng.standard_normal(2), -1, 1)
        return Decision(action, label=decision.action, skill=decision.skill)


def point_expert(_environment: Environment) -> PointExpert:
    """What `evaluate(expert=...)` is given."""
    return PointExpert()
