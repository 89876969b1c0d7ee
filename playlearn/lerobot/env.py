"""Our environments under LeRobot's own commands: `lerobot-eval --env.type=playlearn --env.suite=eval/suites/NAME.yaml`.

Episodes and observations are those of `evaluation.goal_env.GoalEnv`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import FreezeAfterEpisodeEnd

from playlearn.episode import IMAGES
from playlearn.errors import UsageError
from playlearn.evaluation.goal_env import GoalEnv
from playlearn.evaluation.suite import load_suite


@EnvConfig.register_subclass("playlearn")
@dataclass
class PlaylearnEnvConfig(EnvConfig):  # type: ignore[misc]
    """LeRobot's config of an environment.

    suite: file with the environment, start states, goals and budgets.
    max_steps: instead of the suite's.
    task: LeRobot's own, unused.
    fps: control steps a second, taken from the environment.
    features: of observations and actions, taken from the environment.
    features_map: gymnasium key -> LeRobot key.
    disable_env_checker: LeRobot's own.

    Raises UsageError if no suite is named.
    """

    suite: str = ""
    max_steps: int | None = None
    task: str | None = None
    fps: int = 20
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)
    disable_env_checker: bool = True

    def __post_init__(self) -> None:
        if not self.suite:
            raise UsageError("--env.suite names no suite: give one of eval/suites/*.yaml")
        env = self.make()
        self.fps = round(env.env.spec.fps)
        self.features = {"action": PolicyFeature(FeatureType.ACTION, env.action_space.shape or ())}
        self.features_map = {"action": "action"}
        numbers = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}
        for key, space in env.observation_spaces.items():
            if isinstance(space, spaces.Dict):
                for camera, box in space.items():
                    self.features[f"pixels/{camera}"] = PolicyFeature(FeatureType.VISUAL, box.shape)
                    self.features_map[f"pixels/{camera}"] = IMAGES + camera
            else:
                kind = FeatureType.ENV if key == "environment_state" else FeatureType.STATE
                self.features[key] = PolicyFeature(kind, space.shape)
                self.features_map[key] = numbers.get(key, f"observation.{key}")
        env.close()

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {}

    def make(self) -> "GoalEnv":
        return GoalEnv(load_suite(Path(self.suite)), self.max_steps)

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        kind = gym.vector.AsyncVectorEnv if use_async_envs and n_envs > 1 else gym.vector.SyncVectorEnv
        # An environment that is done waits for the others; LeRobot would go on with a new start and goal each time.
        make = lambda: FreezeAfterEpisodeEnd(self.make())  # noqa: E731
        envs = kind([make] * n_envs, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
        return {Path(self.suite).stem: {0: envs}}
