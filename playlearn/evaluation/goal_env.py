"""Goal-conditioned episodes as a gymnasium environment, of a suite: seed n sets up episode n, as in `playlearn eval`.

The goal is observed as one more camera, `goal_<camera>`, and as states, of the objects and of the robot.
"""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from playlearn.episode import Array
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.actor_recipes import scripted
from playlearn.evaluation.suite import EvalEpisode, SuiteConfig
from playlearn.report.pictures import beside
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment

LIMIT = np.float32(1e3)  # bound of the observation space: meters, radians, fractions


class GoalEnv(gym.Env[dict[str, Any], Array]):
    """A suite's episodes as a gymnasium environment; actions (A,) in [-1, 1].

    Observations: pixels {camera, goal_camera: (h, w, 3) uint8}, agent_pos (S,), environment_state (2 G,) achieved goal
    and goal, goal.state (G,), goal.proprio (S,) the robot's own state in the goal. Success, as the suite defines it,
    ends an episode with a reward of 1.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - as gymnasium declares it

    def __init__(
        self,
        suite: SuiteConfig,
        max_steps: int | None = None,
        expert: Callable[[Environment], Actor] = scripted,
        render_mode: str = "rgb_array",
    ) -> None:
        """max_steps: instead of the suite's. expert: builds the expert that makes the goals (see `SuiteKind.setup`)."""
        self.suite, self.render_mode = suite, render_mode
        self.env = suite.environment.build()
        self._expert = expert(self.env)
        self._kind = suite.kind.prepare(None)
        self._limit = max_steps
        self._max_episode_steps = max_steps or suite.max_steps
        self.metadata = {**self.metadata, "render_fps": round(self.env.spec.fps)}
        self.env.reset(0)
        observed = self.env.observe(self.env.spec.cameras)
        images = {name: image for camera, image in observed.images.items() for name in (camera, f"goal_{camera}")}
        numbers = {
            "agent_pos": len(observed.state),
            "environment_state": 2 * len(observed.achieved),
            "goal.state": len(observed.achieved),
            "goal.proprio": len(observed.state),
        }
        boxes: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-LIMIT, LIMIT, (n,), np.float32) for key, n in numbers.items()
        }
        if images:
            pictures: dict[str, spaces.Space[Any]] = {
                name: spaces.Box(0, 255, image.shape, np.uint8) for name, image in images.items()
            }
            boxes["pixels"] = spaces.Dict(pictures)
        self.observation_space = self.observation_spaces = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.env.spec.action_names),), np.float32)
        self._next = 0
        self._eval_episode: EvalEpisode | None = None
        self._steps, self._steps_held = 0, 0

    @property
    def task(self) -> str:
        """Name of the task of this episode."""
        return "" if self._eval_episode is None else self._eval_episode.task.replace("_", " ")

    task_description = task

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Set up the suite's episode number `seed`; without one, the next."""
        super().reset(seed=seed)
        number = self._next if seed is None else seed
        self._next = number + 1
        suite, cameras = self.suite, self.env.spec.cameras
        self._eval_episode = self._kind.setup(self.env, self._expert, number, suite.seed, suite.max_steps, cameras)
        if self._eval_episode.goal.state is None:
            raise UsageError(f"suite {suite.name}: its goals leave the robot's own state open, and LeRobot is given it")
        self.env.set_state(self._eval_episode.start_sim_state)
        self._max_episode_steps = self._limit or self._eval_episode.max_steps or suite.max_steps
        self._steps, self._steps_held = 0, 0
        return self._observation(), {"is_success": False, "task": self._eval_episode.task}

    def step(self, action: Array) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One control step; a failure of the environment (something fell) ends the episode without success."""
        episode = self._eval_episode
        if episode is None:
            raise UsageError("reset the environment before its first step")
        terminated = False
        try:
            self.env.step(np.clip(np.asarray(action, np.float32), -1, 1))
        except PlaylearnError:  # the simulation diverged, or the action is not finite
            terminated = True
        self._steps += 1
        achieved = self.env.observe().achieved
        satisfied = self._kind.judge(self.env, episode.task)(episode.start_achieved, achieved, episode.goal.achieved)
        self._steps_held = self._steps_held + 1 if satisfied and not terminated else 0
        success = self._steps_held >= self.suite.success_hold_steps
        terminated |= success or self.env.failure() is not None
        truncated = not terminated and self._steps >= self._max_episode_steps
        return self._observation(), float(success), terminated, truncated, {"is_success": success, "task": episode.task}

    def render(self) -> Array:
        """(h, w, 3) uint8: the environment with its goal beside it."""
        camera = self.suite.camera
        now = self.env.render(camera)
        goal = None if self._eval_episode is None else self._eval_episode.goal.images.get(camera)
        return now if goal is None else beside(now, goal)

    def close(self) -> None:
        self.env.close()

    def _observation(self) -> dict[str, Any]:
        assert self._eval_episode is not None  # noqa: S101 - only called after reset
        goal, cameras = self._eval_episode.goal, self.env.spec.cameras
        observed = self.env.observe(cameras)
        observation: dict[str, Any] = {
            "agent_pos": np.array(observed.state, np.float32),
            "environment_state": np.concatenate([observed.achieved, goal.achieved]).astype(np.float32),
            "goal.state": np.array(goal.achieved, np.float32),
            "goal.proprio": np.array(goal.state, np.float32),
        }
        if cameras:
            observation["pixels"] = _pixels(observed.images, goal.images, cameras)
        return observation


def _pixels(now: Any, goal: Any, cameras: Sequence[str]) -> dict[str, Array]:
    own = {camera: np.array(now[camera]) for camera in cameras}
    return own | {f"goal_{camera}": np.array(goal[camera]) for camera in cameras}
