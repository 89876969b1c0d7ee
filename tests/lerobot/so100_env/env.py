"""Six position-controlled joints of an SO-100, in degrees and percent: its play, and poses to be reached."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from playlearn.episode import Array

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NAMES = tuple(f"{motor}.pos" for motor in MOTORS)
CENTER = np.array([0.0, -60.0, 70.0, 60.0, 0.0, 20.0])
SPAN = np.array([25.0, 25.0, 20.0, 15.0, 2.0, 18.0])
FOLLOWED = 0.35  # of the way to what is commanded, each step
NEAR = 0.4  # of the span of each joint
STEPS = 60  # of an episode
HELD = 20  # steps with the gripper closed, and with it opened


def pose(rng: np.random.Generator) -> Array:
    """(6,) somewhere, the gripper closed."""
    at = rng.uniform(-1, 1, len(MOTORS))
    at[-1] = -1.0
    return CENTER + SPAN * at


def play(rng: np.random.Generator, places: int = 8) -> tuple[Array, Array]:
    """State and action, (T, 6) each: to one place after another, released there each time; actions are poses."""
    at, states, actions = pose(rng), [], []
    for there in [pose(rng) for _ in range(places)]:
        opened = np.append(there[:-1], CENTER[-1] + SPAN[-1])
        for action in [there] * HELD + [opened] * HELD:
            states.append(at)
            actions.append(action)
            at = at + FOLLOWED * (action - at)
    return np.array(states, np.float32), np.array(actions, np.float32)


class So100Env(gym.Env[dict[str, Any], Array]):
    """Observations: agent_pos (6,) and goal.proprio (6,), the pose to be reached; actions (6,), poses.

    render_mode: gymnasium's own.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - as gymnasium declares it
    task, task_description = "reach", "reach a pose"
    _max_episode_steps = STEPS

    def __init__(self, render_mode: str = "rgb_array") -> None:
        self.render_mode = render_mode
        poses = spaces.Box(-360.0, 360.0, (len(MOTORS),), np.float32)
        self.observation_space = spaces.Dict({"agent_pos": poses, "goal.proprio": poses})
        self.action_space = poses
        self._at, self._goal, self._steps = CENTER, CENTER, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        super().reset(seed=seed)
        self._at, self._goal = pose(self.np_random), pose(self.np_random)
        self._steps = 0
        return self._observation(), {"is_success": False}

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self._at = self._at + FOLLOWED * (np.asarray(action, np.float64) - self._at)
        self._steps += 1
        success = bool((np.abs(self._at - self._goal) < NEAR * SPAN).all())
        return self._observation(), float(success), success, self._steps >= STEPS, {"is_success": success}

    def render(self) -> Array:
        return np.full((32, 32, 3), self._steps, np.uint8)

    def _observation(self) -> dict[str, Any]:
        return {"agent_pos": self._at.astype(np.float32), "goal.proprio": self._goal.astype(np.float32)}


@EnvConfig.register_subclass("so100")
@dataclass
class So100EnvConfig(EnvConfig):  # type: ignore[misc]
    """`--env.type=so100`; the fields are LeRobot's own."""

    fps: int = 20
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {
            "action": PolicyFeature(FeatureType.ACTION, (len(MOTORS),)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(MOTORS),)),
            "goal.proprio": PolicyFeature(FeatureType.STATE, (len(MOTORS),)),
        }
    )
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            "action": "action",
            "agent_pos": "observation.state",
            "goal.proprio": "observation.goal.proprio",
        }
    )

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        envs = gym.vector.SyncVectorEnv([So100Env] * n_envs, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
        return {"so100": {0: envs}}
