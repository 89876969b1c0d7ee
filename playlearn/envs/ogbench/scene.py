"""OGBench's scene: a cube, a drawer and a window, and two buttons that lock and unlock them.

`achieved` (19,):

    block_0.x y z c s     as in the cube environments
    button_i.x y z on     meters, where its top is, pressed or not; on: 1 unlocks the drawer (0) or the window (1)
    drawer.x y z          meters, where its handle is: y goes with the drawer
    window.x y z          meters, where its handle is: x goes with the window
"""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from ogbench.manipspace.envs.scene_env import SceneEnv
from ogbench.manipspace.oracles.plan.button_plan import ButtonPlanOracle
from ogbench.manipspace.oracles.plan.cube_plan import CubePlanOracle
from ogbench.manipspace.oracles.plan.drawer_plan import DrawerPlanOracle
from ogbench.manipspace.oracles.plan.window_plan import WindowPlanOracle

from playlearn.envs.ogbench.cube import PARTS, block
from playlearn.envs.ogbench.env import TOLERANCE, OgbenchEnv, Oracle
from playlearn.episode import Array
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, Task

BUTTONS = 2
NAMES = (
    *(f"block_0.{part}" for part in PARTS),
    *(f"button_{i}.{part}" for i in range(BUTTONS) for part in ("x", "y", "z", "on")),
    *(f"{fixture}.{axis}" for fixture in ("drawer", "window") for axis in ("x", "y", "z")),
)
BLOCK, ON, DRAWER, WINDOW = slice(0, 3), [8, 12], slice(13, 16), slice(16, 19)
DRAWER_Y, WINDOW_X = 14, 16
OPENED, SHUT = -0.16, 0.0  # meters of the drawer's joint
_PRESSED = -0.02  # meters that a button goes down before it switches
_BEYOND = 0.2  # meters outside the workspace at which OGBench calls a cube lost
_RIGHT, _LEFT, _INSIDE = 0.29, -0.3, (0.06, 0.08)  # meters: where a cube is out of sight, and how high in the drawer


class OgbenchSceneEnv(OgbenchEnv):
    """See the module's docstring. end_unseen: a cube that is out of sight and not in the drawer is a failure."""

    def __init__(
        self,
        config: EnvironmentConfig,
        cameras: Mapping[str, CameraConfig],
        *,
        see_through: bool = True,
        exact: bool = False,
        end_unseen: bool = False,
    ) -> None:
        self._end_unseen = end_unseen
        self._shared: dict[str, bytes] = {}  # by clones, as the model is: how that is switched
        super().__init__(
            config, SceneEnv, NAMES, cameras, see_through=see_through, exact=exact, switches=BUTTONS, env_type="scene"
        )

    @property
    def drawer(self) -> float:
        """Meters of its joint, -0.16 open .. 0 shut."""
        return float(self.data.joint("drawer_slide").qpos[0])

    def failure(self) -> str | None:
        place = self.data.joint("object_joint_0").qpos[:3]
        low, high = self.env._workspace_bounds
        if (place <= low - _BEYOND).any() or (place >= high + _BEYOND).any():
            return "the cube is lost"
        inside = _INSIDE[0] <= place[2] <= _INSIDE[1]
        if self._end_unseen and (place[1] >= _RIGHT or (place[1] <= _LEFT and not inside)):
            return "the cube is out of sight"
        return None

    def reached(self, achieved: Array, goal: Array) -> bool:
        off = np.abs(achieved.astype(float) - goal.astype(float))
        sliding = max(off[DRAWER_Y], off[WINDOW_X]) <= TOLERANCE
        return bool(np.linalg.norm(off[BLOCK]) <= TOLERANCE and sliding and (off[ON] < 0.5).all())

    def oracles(self, noise: float, smoothing: float) -> Mapping[str, Oracle]:
        kinds = {"cube": CubePlanOracle, "button": ButtonPlanOracle, "drawer": DrawerPlanOracle}
        kinds["window"] = WindowPlanOracle
        return {name: kind(env=self.env, noise=noise, noise_smoothing=smoothing) for name, kind in kinds.items()}

    def stacking(self, rng: np.random.Generator) -> float:
        return 0.5  # of one cube, none is

    def _achieved(self) -> Array:
        parts = [block(self.model, self.data, 0)]
        for i in range(BUTTONS):
            top = self.data.site_xpos[self.env._button_site_ids[i]]
            down = self.data.joint(f"buttonbox_joint_{i}").qpos[0]
            parts.append(np.array([top[0], top[1], top[2] + down, self.env._cur_button_states[i]]))
        handles = self.env._drawer_site_id, self.env._window_site_id
        return np.concatenate([*parts, *(self.data.site_xpos[handle] for handle in handles)])

    def _task(self, info: Mapping[str, Any]) -> Task:
        wanted = info["goal"]
        handles = self.handle("drawer_slide", wanted["drawer_pos"]), self.handle("window_slide", wanted["window_pos"])

        def pose(env: OgbenchSceneEnv, rng: np.random.Generator) -> Array:
            return env.pose(info, rng)

        def arrange(env: OgbenchSceneEnv, rng: np.random.Generator) -> None:
            env.pose(info, rng)

        def command(achieved: Array, rng: np.random.Generator) -> Array:
            goal = achieved.copy()
            goal[BLOCK], goal[3:5] = wanted["block_xyzs"][0], (1.0, 0.0)
            goal[ON], goal[DRAWER], goal[WINDOW] = wanted["button_states"], *handles
            return goal

        def judge(start: Array, achieved: Array, goal: Array) -> bool:
            return self.reached(achieved, command(achieved, np.random.default_rng(0)))

        return Task(info["task_name"], info["task_name"], lambda _: True, arrange, command, judge, pose)

    def handle(self, joint: str, position: float) -> Array:
        """(3,) m where a handle is when its joint is at `position` m."""
        data = mujoco.MjData(self.model)
        data.joint(joint).qpos[0] = position
        mujoco.mj_kinematics(self.model, data)
        site = self.env._drawer_site_id if joint == "drawer_slide" else self.env._window_site_id
        return np.array(data.site_xpos[site])

    # The buttons ----------------------------------------------------------------------------------

    def _apply(self) -> None:
        """Their colors, and how hard drawer and window are to move."""
        if self._shared.get("switched") != self._kept().tobytes():
            own, self.env._data = self.env._data, mujoco.MjData(self.model)  # theirs computes a state forward
            self.env._apply_button_states()
            self.env._data, self._shared["switched"] = own, self._kept().tobytes()

    def _forget(self) -> None:
        self._shared.clear()

    def _after_step(self, before: Array) -> None:
        for i in range(BUTTONS):
            at = int(self.model.joint(f"buttonbox_joint_{i}").qposadr[0])
            if before[at] > _PRESSED >= self.data.qpos[at]:
                self.env._cur_button_states[i] = 1 - self.env._cur_button_states[i]
        self.env._apply_button_states()
        self._shared["switched"] = self._kept().tobytes()

    def _paint(self, model: mujoco.MjModel, kept: Array) -> None:
        for i in range(BUTTONS):
            model.geom(f"btngeom_{i}").rgba = self.model.geom(f"btngeom_{i}").rgba
        for handle in ("drawer_handle", "window_handle"):
            model.material(handle).rgba = self.model.material(handle).rgba

    def _kept(self) -> Array:
        return np.array(self.env._cur_button_states, float)

    def _keep(self, kept: Array) -> None:
        self.env._cur_button_states = np.rint(kept).astype(int)
