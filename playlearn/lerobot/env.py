"""Our worlds under LeRobot's own commands: `lerobot-eval --env.type=playlearn --env.suite=eval/suites/NAME.yaml`.

An episode is one of a suite's: seed n sets up its episode n, the very one that `playlearn eval` attempts under that
number. The goal is seen as one more camera, `goal_<camera>`, and as numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import FreezeAfterEpisodeEnd

from playlearn.episode import IMAGES, Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.actor_recipes import scripted
from playlearn.evaluation.suite import EvalEpisode, SuiteConfig, load_suite
from playlearn.report.pictures import beside
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment

LIMIT = np.float32(1e3)  # of any number seen: meters, radians, shares


@EnvConfig.register_subclass("playlearn")
@dataclass
class PlaylearnEnvConfig(EnvConfig):  # type: ignore[misc]
    """suite: the file that says which world, starts, goals and budgets. max_steps: instead of the suite's.

    Raises UsageError where no suite is named.
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
        kinds = {"agent_pos": FeatureType.STATE, "environment_state": FeatureType.ENV, "goal.state": FeatureType.STATE}
        for key, space in env.seen.items():
            if isinstance(space, spaces.Dict):
                for camera, box in space.items():
                    self.features[f"pixels/{camera}"] = PolicyFeature(FeatureType.VISUAL, box.shape)
                    self.features_map[f"pixels/{camera}"] = IMAGES + camera
            else:
                self.features[key] = PolicyFeature(kinds[key], space.shape)
                self.features_map[key] = numbers.get(key, f"observation.{key}")
        env.close()

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {}

    def make(self) -> "GoalEnv":
        return GoalEnv(load_suite(Path(self.suite)), self.max_steps)

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        kind = gym.vector.AsyncVectorEnv if use_async_envs and n_envs > 1 else gym.vector.SyncVectorEnv
        # One that is done waits for the others; LeRobot would have it play on, with a new start and goal each time.
        make = lambda: FreezeAfterEpisodeEnd(self.make())  # noqa: E731
        envs = kind([make] * n_envs, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
        return {Path(self.suite).stem: {0: envs}}


class GoalEnv(gym.Env[dict[str, Any], Array]):
    """A suite's episodes as a gymnasium environment; actions (A,) in [-1, 1].

    Observations: pixels {camera, goal_camera: (h, w, 3) uint8}, agent_pos (S,), environment_state (2 G,) what is and
    what shall be, goal.state (G,). Success, as the suite judges it, ends an episode with a reward of 1.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - gymnasium's own way

    def __init__(
        self,
        suite: SuiteConfig,
        max_steps: int | None = None,
        expert: Callable[[Environment], Actor] = scripted,
        render_mode: str = "rgb_array",
    ) -> None:
        """max_steps: instead of the suite's. expert: makes who shows the goals (see `SuiteKind.setup`)."""
        self.suite, self.render_mode = suite, render_mode
        self.env = suite.environment.build()
        self._expert = expert(self.env)
        self._kind = suite.kind.prepare(None)
        self._limit = max_steps
        self._max_episode_steps = max_steps or suite.max_steps
        self.metadata = {**self.metadata, "render_fps": round(self.env.spec.fps)}
        self.env.reset(0)
        seen = self.env.observe(self.env.spec.cameras)
        shown = {name: image for camera, image in seen.images.items() for name in (camera, f"goal_{camera}")}
        numbers = {
            "agent_pos": len(seen.state),
            "environment_state": 2 * len(seen.achieved),
            "goal.state": len(seen.achieved),
        }
        boxes: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-LIMIT, LIMIT, (n,), np.float32) for key, n in numbers.items()
        }
        if shown:
            pictures: dict[str, spaces.Space[Any]] = {
                name: spaces.Box(0, 255, image.shape, np.uint8) for name, image in shown.items()
            }
            boxes["pixels"] = spaces.Dict(pictures)
        self.observation_space = self.seen = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.env.spec.action_names),), np.float32)
        self._next = 0
        self._setup: EvalEpisode | None = None
        self._steps, self._content = 0, 0

    @property
    def task(self) -> str:
        """What the goal of this episode is called."""
        return "" if self._setup is None else self._setup.task.replace("_", " ")

    task_description = task

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Set up the suite's episode number `seed`; without one, the next."""
        super().reset(seed=seed)
        number = self._next if seed is None else seed
        self._next = number + 1
        suite, cameras = self.suite, self.env.spec.cameras
        self._setup = self._kind.setup(self.env, self._expert, number, suite.seed, suite.max_steps, cameras)
        self.env.set_state(self._setup.start)
        self._max_episode_steps = self._limit or self._setup.max_steps or suite.max_steps
        self._steps, self._content = 0, 0
        return self._observation(), {"is_success": False, "task": self._setup.task}

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One control period; the world's own end (something fell) is one without success."""
        setup = self._setup
        if setup is None:
            raise UsageError("reset the environment before its first step")
        over = False
        try:
            self.env.step(np.clip(np.asarray(action, np.float32), -1, 1))
        except PlaylearnError:  # physics broke, or the action is no number
            over = True
        self._steps += 1
        achieved = self.env.observe().achieved
        content = self._kind.judge(self.env, setup.task)(setup.start_achieved, achieved, setup.goal.achieved)
        self._content = self._content + 1 if content and not over else 0
        success = self._content >= self.suite.success_hold_steps
        over |= success or self.env.failure() is not None
        late = not over and self._steps >= self._max_episode_steps
        return self._observation(), float(success), over, late, {"is_success": success, "task": setup.task}

    def render(self) -> Array:
        """(h, w, 3) uint8: the world, and its goal beside it."""
        camera = self.suite.camera
        now = self.env.render(camera)
        shown = None if self._setup is None else self._setup.goal.images.get(camera)
        return now if shown is None else beside(now, shown)

    def close(self) -> None:
        self.env.close()

    def _observation(self) -> dict[str, Any]:
        assert self._setup is not None  # noqa: S101 - only called after reset
        goal, cameras = self._setup.goal, self.env.spec.cameras
        seen = self.env.observe(cameras)
        told: dict[str, Any] = {
            "agent_pos": np.array(seen.state, np.float32),
            "environment_state": np.concatenate([seen.achieved, goal.achieved]).astype(np.float32),
            "goal.state": np.array(goal.achieved, np.float32),
        }
        if cameras:
            told["pixels"] = _pictures(seen.images, goal.images, cameras)
        return told


def _pictures(now: Any, goal: Any, cameras: Sequence[str]) -> dict[str, Array]:
    own = {camera: np.array(now[camera]) for camera in cameras}
    return own | {f"goal_{camera}": np.array(goal[camera]) for camera in cameras}
