"""Any robosuite scene with one arm, stepped by compiled control and rendered from simplified meshes.

The scene, the robot, the controller's gains and the gripper come from robosuite itself; only the
loop around MuJoCo is ours, because robosuite spends most of a control step in Python.
"""

import contextlib
import copy
import functools
import math
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Self

import mujoco
import numpy as np

import playlearn.sim.robots  # noqa: F401 - registers them
from playlearn.episode import Array, Observation
from playlearn.errors import SimulationDiverged, UsageError
from playlearn.quantity import own_quantities
from playlearn.sim.checks import check_physics, checked_action
from playlearn.sim.environment import CameraConfig, EnvironmentSpec
from playlearn.sim.ik import displace, touching
from playlearn.sim.osc import ArmControl
from playlearn.sim.rendering.gl import backend
from playlearn.sim.rendering.renderer import Renderer

STATE_NAMES = (
    *("eef.x", "eef.y", "eef.z"),
    *("eef.r00", "eef.r10", "eef.r20", "eef.r01", "eef.r11", "eef.r21"),
    "gripper.opening",
)
ACTION_NAMES = ("dx", "dy", "dz", "droll", "dpitch", "dyaw", "gripper")
_SAVED = int(mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL)
_DRAWS = 20


class RobosuiteEnv:
    """The part of `Environment` that is the same for every robosuite task with one arm.

    build: makes the robosuite environment (without renderer or observations).
    achieved_names: what the subclass's `achieved` returns.
    cameras: name -> size of the images.
    extra: how many numbers beside MuJoCo's state the subclass keeps (`self.extra`; a lamp, a latch); they are saved,
        restored and painted.
    paint: (model, what `_shown` returns) -> None, shows these numbers on a model.

    A subclass implements `_achieved`, `_arrange`, `failure`, `reached`, and may override `_after_step`.
    """

    def __init__(
        self,
        build: Callable[[], Any],
        achieved_names: Sequence[str],
        cameras: Mapping[str, CameraConfig],
        extra: int,
        paint: Callable[[mujoco.MjModel, Array], None],
    ) -> None:
        with _quiet():
            robosuite_env = build()
            robosuite_env.reset()
        robot = robosuite_env.robots[0]
        arm = robot.part_controllers["right"]
        self._xml = robosuite_env.model.get_xml()
        self.model = _physics(self._xml)
        self._xml = _placed(self._xml, self.model, robosuite_env.sim.model._model)
        self.model.opt.timestep = robosuite_env.sim.model.opt.timestep
        self.data = mujoco.MjData(self.model)
        self._home = robosuite_env.sim.data.qpos.copy()
        self._site = int(robot.eef_site_id["right"])
        self._arm_qpos, self._arm_qvel = np.asarray(arm.qpos_index, np.int64), np.asarray(arm.qvel_index, np.int64)
        self._rest = np.asarray(robot.init_qpos, float)[: len(self._arm_qpos)]
        scale = (np.asarray(arm.output_max) - np.asarray(arm.output_min)) / 2
        self._arm = ArmControl(
            self.model,
            self.data,
            site=self._site,
            base=self._site_id(f"{arm.naming_prefix}{arm.part_name}_center"),
            qpos=arm.qpos_index,
            qvel=arm.qvel_index,
            ctrl=robot._ref_arm_joint_actuator_indexes,
            kp=arm.kp,
            kd=arm.kd,
            scale=scale,
            rest=self._rest,
            substeps=round(robosuite_env.control_timestep / self.model.opt.timestep),
        )
        fingers_qpos = np.asarray(robot._ref_gripper_joint_pos_indexes["right"], np.int64)
        self._robot_qpos = np.concatenate([np.asarray(arm.qpos_index, np.int64), fingers_qpos])
        self._gripper_model = robot.gripper["right"]
        self._gripper_ctrl = np.asarray(robot._ref_joint_gripper_actuator_indexes["right"], np.int64)
        limits = self.model.actuator_ctrlrange[self._gripper_ctrl]
        self._gripper_center, self._gripper_half = limits.mean(1), (limits[:, 1] - limits[:, 0]) / 2
        fingers = self._gripper_model.important_geoms
        pads = [pad for side in ("left", "right") for pad in fingers.get(f"{side}_fingerpad", [])[:1]]
        self._fingers = [self._geom_id(pad) for pad in pads]  # none where the end effector is a tool
        self._closed = float(sum(self.model.geom_size[geom].min() for geom in self._fingers))
        self._gripper: Array = np.zeros(len(self._gripper_ctrl))
        self.extra = np.zeros(extra)
        self._cameras = dict(cameras)
        self._paint = paint
        self._renderer = Renderer(functools.partial(mujoco.MjSpec.from_string, self._xml), self._home, paint)
        actions = ACTION_NAMES[: 6 + self._gripper_model.dof]
        self.spec = EnvironmentSpec(
            state_names=STATE_NAMES,
            achieved_names=tuple(achieved_names),
            action_names=actions,
            quantities=own_quantities(STATE_NAMES, achieved_names, len(actions)),
            cameras=tuple(cameras),
            fps=float(robosuite_env.control_freq),
            controller={
                "type": "OSC_POSE",
                "robot": type(robot.robot_model).__name__,
                "kp": np.asarray(arm.kp).tolist(),
                "kd": np.asarray(arm.kd).tolist(),
                "output_max": scale.tolist(),
            },
        )
        unknown = [name for name in cameras if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, name) < 0]
        if unknown:
            known = [self.model.camera(i).name for i in range(self.model.ncam)]
            raise UsageError(f"the scene has no camera {unknown[0]!r}; it has {', '.join(known)}")

    # What a subclass implements --------------------------------------------------------------

    def _achieved(self) -> Array:
        raise NotImplementedError

    def _arrange(self, rng: np.random.Generator) -> None:
        """Place objects at random in `self.data`, free of collisions."""
        raise NotImplementedError

    def _after_step(self) -> None:
        """What physics does not do by itself: toggle a lamp."""

    def _shown(self) -> Array:
        """What `paint` is given: which lamps are lit."""
        return self.extra

    # The Environment ------------------------------------------------------------------------------

    def clone(self) -> Self:
        twin = copy.copy(self)
        twin.data = mujoco.MjData(self.model)
        twin._arm = self._arm.clone(twin.data)
        twin._gripper, twin.extra = self._gripper.copy(), self.extra.copy()
        twin.set_state(self.sim_state())
        return twin

    def reset(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(_DRAWS):
            with contextlib.suppress(SimulationDiverged):
                self._begin(rng)
                return
        raise SimulationDiverged(f"no sound start state in {_DRAWS} draws from seed {seed}")

    def _begin(self, rng: np.random.Generator) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._home
        self._gripper[:] = 0.0
        self.extra[:] = 0.0
        self.data.qpos[self._arm_qpos] = self._rest + rng.normal(0.0, 0.02, len(self._rest))
        self._arrange(rng)
        self.settle()

    def settle(self, steps: int = 6) -> None:
        """Let everything come to rest under a still arm with its gripper opening; time starts at 0."""
        still = np.zeros(len(self.spec.action_names))
        still[6:] = -1.0
        for _ in range(steps):
            self.step(still)
        self.data.qvel[:] = 0.0
        self.data.time = 0.0

    def sim_state(self) -> Array:
        size = mujoco.mj_stateSize(self.model, _SAVED)
        state = np.empty(size + len(self._gripper) + len(self.extra))
        mujoco.mj_getState(self.model, self.data, state[:size], _SAVED)
        state[size:] = np.concatenate([self._gripper, self.extra])
        return state

    def set_state(self, sim_state: Array) -> None:
        size = mujoco.mj_stateSize(self.model, _SAVED)
        expected = size + len(self._gripper) + len(self.extra)
        if sim_state.shape != (expected,):
            raise UsageError(f"a simulator state of {sim_state.shape} does not fit this scene, which has ({expected},)")
        mujoco.mj_resetData(self.model, self.data)  # what an aborted step may have left behind
        mujoco.mj_setState(self.model, self.data, np.ascontiguousarray(sim_state[:size]), _SAVED)
        self._gripper[:] = sim_state[size : size + len(self._gripper)]
        self.extra[:] = sim_state[size + len(self._gripper) :]
        self._refresh()

    def park(self, home: Array) -> None:
        """Put the robot where it is in another simulator state, and leave all else as it is."""
        now = self.sim_state()
        self.set_state(home)
        robot = self.data.qpos[self._robot_qpos].copy()
        self.set_state(now)
        self.data.qpos[self._robot_qpos] = robot
        self._refresh()

    def step(self, action: Array) -> None:
        action = checked_action(action, self.spec.action_names)
        before = self.data.time
        self._gripper_model.current_action = self._gripper
        if len(action) > 6:
            self._gripper = np.asarray(self._gripper_model.format_action(action[6:]), float)
        self.data.ctrl[self._gripper_ctrl] = self._gripper_center + self._gripper_half * self._gripper
        try:
            self._arm.step(action[:6])
        except SimulationDiverged as error:
            raise SimulationDiverged(f"the simulation gave up at {before:.2f} s: {error}") from error
        check_physics(self.data, before)
        self._refresh()
        self._after_step()

    def rearrange(self, rng: np.random.Generator) -> None:
        """Place the objects as a random start does, the robot staying where it is; only to be looked at."""
        self._arrange(rng)
        self._refresh()

    def project(self, camera: str, points: Array) -> Array:
        """(n, 3) m to (n, 2): where a camera sees them, x to the right and y down in [-1, 1]; NaN behind it."""
        mujoco.mj_camlight(self.model, self.data)
        ident, size = self.model.camera(camera).id, self._cameras[camera]
        turn = self.data.cam_xmat[ident].reshape(3, 3)  # its columns: to the right, up, back
        right, up, back = ((points - self.data.cam_xpos[ident]) @ turn).T
        depth = np.where(back < 0, -back, np.nan)
        half = np.tan(np.deg2rad(self.model.cam_fovy[ident]) / 2)
        return np.stack([right / depth / half * size.height / size.width, -up / depth / half], axis=1)

    def displace(self, shift: Array, turn: Array) -> bool:
        """See `playlearn.collection.corrections.rollback.CorrectableEnv`."""
        there = displace(self.model, self.data, self._site, self._arm_qpos, self._arm_qvel, shift, turn)
        return there and not self.touching()

    def touching(self) -> bool:
        return touching(self.model, self.data, self._site)

    def observe(self, cameras: Sequence[str] = ()) -> Observation:
        rotation = self.data.site_xmat[self._site].reshape(3, 3)
        state = np.empty(len(STATE_NAMES), np.float32)
        state[:3] = self.data.site_xpos[self._site]
        state[3:9] = rotation[:, :2].T.ravel()
        state[9] = self._opening()
        images = {name: self.render(name) for name in cameras}
        return Observation(state, self._achieved().astype(np.float32), images, float(self.data.time))

    def render(self, camera: str, height: int | None = None, width: int | None = None) -> Array:
        size = self._cameras.get(camera, CameraConfig())
        return self._renderer.draw(self.data.qpos, self._shown(), camera, height or size.height, width or size.width)

    def renderer(self) -> str:
        return backend()

    def scene(self) -> mujoco.MjModel:
        """All of the scene, newly compiled: what is only looked at too, with its meshes as robosuite has them."""
        return mujoco.MjModel.from_xml_string(self._xml)

    def paint(self, model: mujoco.MjModel) -> None:
        """Show on a model of this scene what is kept beside MuJoCo's state: a lit lamp, a door's place."""
        self._paint(model, self._shown())

    def close(self) -> None:
        """Nothing to give back: the GL context belongs to the process."""

    # Inside ---------------------------------------------------------------------------------------

    def _refresh(self) -> None:
        """Bring positions in line with qpos, which integration left one substep behind."""
        mujoco.mj_kinematics(self.model, self.data)

    def _opening(self) -> float:
        """Distance between the finger pads' surfaces in meters, 0 without fingers."""
        if not self._fingers:
            return 0.0
        left, right = (self.data.geom_xpos[geom].tolist() for geom in self._fingers)
        return math.dist(left, right) - self._closed

    def _site_id(self, name: str) -> int:
        return int(self.model.site(name).id)

    def _geom_id(self, name: str) -> int:
        return int(self.model.geom(name).id)


def _placed(xml: str, ours: mujoco.MjModel, theirs: mujoco.MjModel) -> str:
    """Put bodies where robosuite's reset has put them in its compiled model (a door, a bin); the XML that says so."""
    root = ElementTree.fromstring(xml)
    for body in root.iter("body"):
        if "name" not in body.attrib:
            continue
        ident = theirs.body(body.get("name")).id
        here = np.concatenate([theirs.body_pos[ident], theirs.body_quat[ident]])
        if not np.array_equal(here, np.concatenate([ours.body_pos[ident], ours.body_quat[ident]])):
            for other in {"axisangle", "euler", "xyaxes", "zaxis"} & body.attrib.keys():
                del body.attrib[other]
            body.set("pos", " ".join(map(repr, here[:3].tolist())))
            body.set("quat", " ".join(map(repr, here[3:].tolist())))
    ours.body_pos[:], ours.body_quat[:] = theirs.body_pos, theirs.body_quat
    return ElementTree.tostring(root, encoding="unicode")


def _physics(xml: str) -> mujoco.MjModel:
    """What moves and touches: without what is only looked at or sensed, which costs a sixth and changes no bit."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.compiler.discardvisual = True
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """robosuite without its warnings about its own syntax and dependencies."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
