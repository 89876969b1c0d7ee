"""OGBench's manipulation environments (Park et al., 2024, arXiv:2410.20092) behind the Environment contract.

The scene, the arm's inverse kinematics, start states, tasks and their goals are OGBench's own code; the loop around
MuJoCo is ours, because its `step` computes every observation three times. Bit for bit it does what theirs does: of
the end effector's pose, which its control reads, MuJoCo leaves the one of a substep ago: it is saved here too.

`observation.state` (19,), all of OGBench's robot observation, in SI units:

    eef.x eef.y eef.z eef.c eef.s    meters, (cos, sin) yaw of the end effector
    gripper.opening                  meters, 0 shut .. 0.085
    gripper.contact                  0 .. 1, the force on a finger, 50 N and more are 1
    arm.q0 ... arm.q5                rad
    arm.v0 ... arm.v5                rad/s

Actions (5,): 0.05 m, 0.3 rad of yaw and a whole opening, relative to where the end effector is; gripper +1 closes.
"""

import copy
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self

import mujoco
import numpy as np
from ogbench.manipspace import mjcf_utils
from ogbench.manipspace.envs.manipspace_env import ManipSpaceEnv

from playlearn.envs.ogbench.picture import Pictures
from playlearn.episode import Array, Observation
from playlearn.errors import UsageError
from playlearn.quantity import own_quantities
from playlearn.sim.checks import check_physics, checked_action
from playlearn.sim.environment import CameraConfig, EnvironmentConfig, EnvironmentSpec, Task
from playlearn.sim.rendering.gl import backend
from playlearn.sim.rendering.renderer import Renderer
from playlearn.sim.rendering.simplify import VISUAL_GROUP
from playlearn.store.ogbench import ACTION_NAMES, STATE_NAMES, WIDEST

TOLERANCE = 0.04  # meters, OGBench's own, of cubes, drawer and window
_SHUT = 0.8  # rad of the gripper's joint
_HARD = 50.0  # newtons
_SAVED = int(mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL)
_SHOWN, _HIDDEN = 2, 5  # the last group of what is drawn, and one of what is not
_HAND = 13  # numbers kept of the end effector beside MuJoCo's state: position, rotation, contact


class Oracle(Protocol):
    """What OGBench's oracles offer."""

    @property
    def done(self) -> bool: ...
    def reset(self, ob: Any, info: Mapping[str, Any]) -> None: ...
    def select_action(self, ob: Any, info: Mapping[str, Any]) -> Array: ...


class OgbenchEnv:
    """What its environments share.

    config: builds the same environment again; on record only, nothing else is read from it.
    kind: class of OGBench's environment; `options` go to its constructor.
    achieved_names: what `_achieved` returns.
    cameras: name -> size of the images.
    see_through: draw the arm all but transparent.
    exact: draw every pixel as OGBench does.
    switches: number of states that MuJoCo does not hold (a pressed button).

    A subclass implements `_achieved`, `reached`, `_task` and `oracles`, and may override `failure` and what follows it.
    """

    tasks: Mapping[str, Task]

    def __init__(
        self,
        config: EnvironmentConfig,
        kind: type,
        achieved_names: Sequence[str],
        cameras: Mapping[str, CameraConfig],
        *,
        see_through: bool,
        exact: bool,
        switches: int = 0,
        **options: Any,
    ) -> None:
        self.config, self._cameras, self._draws_exactly, self._switches = config, dict(cameras), exact, switches
        self.env = _reproducible(kind)(
            mode="task",  # only so does it know its tasks
            visualize_info=False,
            terminate_at_goal=False,
            pixel_transparent_arm=see_through,
            **options,
        )
        self.env.saved = lambda: None
        self.env._ob_type = "pixels"  # the scene of its pixel environments: other colors
        self.env._mjcf_model = self.env.build_mjcf_model()
        self.env._ob_type, self.env._mode = "states", "data_collection"
        self.env.reset(seed=0)
        self.env.saved = self.sim_state
        self.model, self.data = self.env.model, self.env.data
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._site, self._pad = int(self.env._pinch_site_id), int(self.model.body("ur5e/robotiq/right_pad").id)
        self._arm = self.model.jnt_qposadr[self.env._arm_joint_ids], self.model.jnt_dofadr[self.env._arm_joint_ids]
        self._finger = int(self.model.jnt_qposadr[self.env._gripper_opening_joint_id])
        self._contact = 0.0
        self._exact = Pictures(self.model)
        self._quick = Renderer(self.scene, np.array(self.data.qpos), self._paint)
        self.spec = EnvironmentSpec(
            state_names=STATE_NAMES,
            achieved_names=tuple(achieved_names),
            action_names=ACTION_NAMES,
            quantities=own_quantities(STATE_NAMES, achieved_names, len(ACTION_NAMES)),
            cameras=tuple(cameras),
            fps=1.0 / self.env.control_timestep(),
            controller={"type": "OGBench", "robot": "UR5e", "output_max": self.env.action_high.tolist()},
        )
        self.tasks = {info["task_name"]: self._task(info) for info in self.env.task_infos}

    # What a subclass implements -----------------------------------------------------------------------

    def _achieved(self) -> Array:
        raise NotImplementedError

    def reached(self, achieved: Array, goal: Array) -> bool:
        raise NotImplementedError

    def _task(self, info: Mapping[str, Any]) -> Task:
        """One of OGBench's tasks."""
        raise NotImplementedError

    def oracles(self, noise: float, smoothing: float) -> Mapping[str, Oracle]:
        """Kind of target -> the planning oracle that brings it about."""
        raise NotImplementedError

    def stacking(self, rng: np.random.Generator) -> float:
        """How probably a cube's target is on another one, in an episode of OGBench's play."""
        raise NotImplementedError

    def failure(self) -> str | None:
        return None

    def _apply(self) -> None:
        """Bring the model, which clones share, in line with this environment's switches."""

    def _paint(self, model: mujoco.MjModel, kept: Array) -> None:
        """Show the switches on a model of the scene."""

    def _forget(self) -> None:
        """OGBench is about to set the switches itself."""

    def _after_step(self, before: Array) -> None:
        """What MuJoCo does not do by itself; before (nq,): the positions a step ago."""

    # The Environment ----------------------------------------------------------------------------------

    def clone(self) -> Self:
        twin = copy.copy(self)
        twin.data = mujoco.MjData(self.model)
        twin.env = copy.copy(self.env)
        twin.env._data, twin.env.saved = twin.data, twin.sim_state
        twin.set_state(self.sim_state())
        return twin

    def reset(self, seed: int) -> None:
        self._begin(np.random.default_rng(seed))

    def pose(self, info: Mapping[str, Any], rng: np.random.Generator) -> Array:
        """Begin one of OGBench's tasks as its evaluation does; returns the simulator state (N,) of its goal."""
        self.env._mode, self.env.cur_task_info, self.env._render_goal = "task", info, False
        try:
            self._begin(rng)
        finally:
            self.env._mode = "data_collection"
        return np.array(self.env._cur_goal_ob)

    def _begin(self, rng: np.random.Generator) -> None:
        self.env._np_random = rng
        self._forget()
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self.env.initialize_episode()
        mujoco.mj_forward(self.model, self.data)
        self._feel()

    def sim_state(self) -> Array:
        size = mujoco.mj_stateSize(self.model, _SAVED)
        state = np.empty(size + _HAND + self._switches)
        mujoco.mj_getState(self.model, self.data, state[:size], _SAVED)
        hand = [self.data.site_xpos[self._site], self.data.site_xmat[self._site], [self._contact]]
        state[size:] = np.concatenate([*hand, self._kept()])
        return state

    def set_state(self, sim_state: Array) -> None:
        """Restore `sim_state`, or a row of OGBench's datasets (see `playlearn.store.ogbench`)."""
        size, coordinates = mujoco.mj_stateSize(self.model, _SAVED), self.model.nq + self.model.nv
        expected = size + _HAND + self._switches
        if sim_state.shape == (coordinates + self._switches,):
            self._set_coordinates(sim_state[:coordinates], sim_state[coordinates:])
            return
        if sim_state.shape != (expected,):
            raise UsageError(f"a simulator state of {sim_state.shape} does not fit this scene, which has ({expected},)")
        hand, kept = sim_state[size : size + _HAND], sim_state[size + _HAND :]
        mujoco.mj_resetData(self.model, self.data)  # what an aborted step may have left behind
        self._keep(kept)
        self._apply()
        mujoco.mj_setState(self.model, self.data, np.ascontiguousarray(sim_state[:size]), _SAVED)
        mujoco.mj_kinematics(self.model, self.data)
        self.data.site_xpos[self._site], self.data.site_xmat[self._site] = hand[:3], hand[3:12]
        self._contact = float(hand[12])

    def step(self, action: Array) -> None:
        action = checked_action(action, ACTION_NAMES)
        self._apply()
        before, qpos = self.data.time, self.data.qpos.copy()
        self.env.set_control(action)
        mujoco.mj_step(self.model, self.data, nstep=self.env._n_steps)
        mujoco.mj_rnePostConstraint(self.model, self.data)
        check_physics(self.data, before)
        self._after_step(qpos)
        self._feel()

    def observe(self, cameras: Sequence[str] = ()) -> Observation:
        rotation = self.data.site_xmat[self._site].reshape(3, 3)
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        opening = WIDEST * (1.0 - np.clip(self.data.qpos[self._finger] / _SHUT, 0.0, 1.0))
        qpos, qvel = self._arm
        hand = [*self.data.site_xpos[self._site], np.cos(yaw), np.sin(yaw), opening, self._contact]
        state = np.array([*hand, *self.data.qpos[qpos], *self.data.qvel[qvel]], np.float32)
        images = {name: self.render(name) for name in cameras}
        return Observation(state, self._achieved().astype(np.float32), images, float(self.data.time))

    def render(self, camera: str, height: int | None = None, width: int | None = None) -> Array:
        size = self._cameras[camera]
        height, width, view = height or size.height, width or size.width, f"{camera}_pixels"
        self._apply()
        if self._draws_exactly:
            return self._exact.draw(self.data, view, height, width)
        return self._quick.draw(self.data.qpos, self._kept(), view, height, width)

    def scene(self) -> mujoco.MjSpec:
        """What there is to be seen, in OGBench's colors of this moment."""
        xml, assets = mjcf_utils.to_string(self.env.mjcf_model), mjcf_utils.get_assets(self.env.mjcf_model)
        spec = mujoco.MjSpec.from_string(xml, assets=assets)
        for geom, rgba in zip(spec.geoms, self.model.geom_rgba, strict=True):
            geom.rgba = rgba
            geom.group = VISUAL_GROUP if geom.group <= _SHOWN and rgba[3] > 0 else _HIDDEN
        return spec

    def renderer(self) -> str:
        return backend()

    def close(self) -> None:
        """Nothing to give back: the GL context belongs to the process."""

    # Inside -------------------------------------------------------------------------------------------

    def _set_coordinates(self, coordinates: Array, kept: Array) -> None:
        """A state as OGBench's datasets have it: positions, velocities and switches; no force is felt in it."""
        mujoco.mj_resetData(self.model, self.data)
        self._keep(kept)
        self._apply()
        self.data.qpos[:], self.data.qvel[:] = np.split(coordinates, [self.model.nq])
        mujoco.mj_forward(self.model, self.data)
        self._contact = 0.0

    def _feel(self) -> None:
        """Read the force on a finger, which a restored state does not hold."""
        self._contact = float(np.clip(np.linalg.norm(self.data.cfrc_ext[self._pad]) / _HARD, 0.0, 1.0))

    def _kept(self) -> Array:
        """(switches,) the states that MuJoCo does not hold."""
        return np.zeros(0)

    def _keep(self, kept: Array) -> None:
        """Set them."""


def _reproducible(kind: Any) -> Any:
    """OGBench's class, reproducible from its generator, with whole simulator states for goals."""

    class Reproducible(kind):  # type: ignore[misc]
        saved: Any

        @property
        def action_space(self) -> Any:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that float64 bounds become float32
                space = super().action_space
            space.seed(int(self.np_random.integers(2**31)))  # theirs begins with the system's entropy
            return space

        def compute_observation(self) -> Any:
            return self.saved()

    assert issubclass(kind, ManipSpaceEnv)  # noqa: S101
    return Reproducible
