"""OGBench's cube environments: one to four cubes on a table.

`achieved` (5 n,): block_i.x y z c s, as `playlearn.envs.pieces` has them: meters and (cos, sin)(4 yaw), the same after
every quarter turn. OGBench's observation has quaternion and yaw instead, its goals have x y z alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from ogbench.manipspace.envs.cube_env import CubeEnv
from ogbench.manipspace.oracles.plan.cube_plan import CubePlanOracle

from playlearn.envs.ogbench.env import TOLERANCE, OgbenchEnv, Oracle
from playlearn.envs.pieces.env import yaw_code
from playlearn.episode import Array
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, Task

PARTS = ("x", "y", "z", "c", "s")
KINDS = ("single", "double", "triple", "quadruple")
_STACKING = ((0.0, 0.0), (0.0, 0.25), (0.05, 0.35), (0.1, 0.5))  # between which an episode's probability is drawn


class OgbenchCubeEnv(OgbenchEnv):
    """See the module's docstring."""

    def __init__(
        self,
        config: EnvironmentConfig,
        cubes: int,
        cameras: Mapping[str, CameraConfig],
        *,
        see_through: bool = True,
        exact: bool = False,
    ) -> None:
        self._cubes = cubes
        names = [f"block_{i}.{part}" for i in range(cubes) for part in PARTS]
        kind = KINDS[cubes - 1]
        super().__init__(config, CubeEnv, names, cameras, see_through=see_through, exact=exact, env_type=kind)

    def _achieved(self) -> Array:
        return np.concatenate([block(self.model, self.data, i) for i in range(self._cubes)])

    def reached(self, achieved: Array, goal: Array) -> bool:
        return bool((np.linalg.norm(places(achieved) - places(goal), axis=1) <= TOLERANCE).all())

    def oracles(self, noise: float, smoothing: float) -> Mapping[str, Oracle]:
        return {"cube": CubePlanOracle(env=self.env, noise=noise, noise_smoothing=smoothing)}

    def stacking(self, rng: np.random.Generator) -> float:
        return float(rng.uniform(*_STACKING[self._cubes - 1]))

    def _task(self, info: Mapping[str, Any]) -> Task:
        begins, ends = info["init_xyzs"], info["goal_xyzs"]  # (n, 3) m each, of the cubes in any order

        def pose(env: OgbenchCubeEnv, rng: np.random.Generator) -> Array:
            return env.pose(info, rng)

        def arrange(env: OgbenchCubeEnv, rng: np.random.Generator) -> None:
            env.pose(info, rng)

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.reshape(-1, 5).copy()
            goal[:, :3] = ends[assigned(places(achieved), begins)]
            goal[:, 3:] = (1.0, 0.0)
            return goal.ravel()

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            # What is shown as the goal has settled by a millimeter from where the task has it.
            wanted = ends[assigned(places(goal), ends)]
            return bool((np.linalg.norm(places(achieved) - wanted, axis=1) <= TOLERANCE).all())

        return Task(info["task_name"], info["task_name"], lambda _: True, arrange, command, judge, pose)


def block(model: mujoco.MjModel, data: mujoco.MjData, index: int) -> Array:
    """(5,) x y z c s of a cube, from its free joint."""
    start = int(model.joint(f"object_joint_{index}").qposadr[0])
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[start + 3 : start + 7])
    return np.concatenate([data.qpos[start : start + 3], yaw_code(rotation.reshape(3, 3), 4)])


def places(achieved: Array) -> Array:
    """(n, 3) m of the cubes."""
    return achieved.reshape(-1, 5)[:, :3].astype(float)


def assigned(cubes: Array, slots: Array) -> Sequence[int]:
    """Which of the slots (n, 3) each cube (n, 3) is at: each takes one, the nearest pairs first."""
    far = np.linalg.norm(cubes[:, None] - slots[None], axis=2)  # (cubes, slots)
    taken = [0] * len(cubes)
    for _ in cubes:
        cube, slot = np.unravel_index(int(far.argmin()), far.shape)
        taken[int(cube)] = int(slot)
        far[cube], far[:, slot] = np.inf, np.inf
    return taken
