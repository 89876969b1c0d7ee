"""Operational-space control of an arm, compiled into a callback that MuJoCo itself calls in every physics step.

    tau = J^T [L_p (kp e_p - kd v_p); L_r (kp e_r - kd v_r)] + g(q) + N^T M (k (q0 - q) - 2 sqrt(k) qd)

with L = (J M^-1 J^T)^-1 the arm's inertia in the task space, L_p and L_r those of position and of orientation
alone, and N the null space of J (Khatib, 1987). This is robosuite's OSC_POSE, to the last bit where both run on
one machine: its own compiled functions do the algebra, and what it does in numpy around them is done in the same
order. Rounding matters: in a
gripper whose fingers touch each other, a torque that differs by 1e-13 moves a finger by a millimeter in 14 ms.
A Cholesky solution would make a control step a third shorter.
"""

import functools
import threading
from collections.abc import Sequence
from typing import Any

import mujoco
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from robosuite.utils import transform_utils
from robosuite.utils.control_utils import nullspace_torques, opspace_matrices, orientation_error

from playlearn.episode import Array
from playlearn.errors import SimulationDiverged

MOST_JOINTS = 8

# What the callback knows of one environment: addresses of MuJoCo's arrays, indices, gains, this control period's goal.
_ARM_RECORD = np.dtype(
    [
        *((name, "i8") for name in ("data", "qpos", "qvel", "bias", "inertia", "ctrl")),
        *((name, "i8") for name in ("dof_axes", "root_com", "site_pos", "site_mat", "base_pos", "base_mat")),
        *((name, "i8") for name in ("nq", "nv", "nu", "nM", "joints")),
        *((name, "i8", (MOST_JOINTS,)) for name in ("qpos_at", "qvel_at", "ctrl_at", "moves_site", "moves_base")),
        ("inertia_at", "i8", (MOST_JOINTS, MOST_JOINTS)),
        ("torque_range", "f8", (MOST_JOINTS, 2)),
        ("rest", "f8", (MOST_JOINTS,)),
        ("kp", "f8", (6,)),
        ("kd", "f8", (6,)),
        ("delta", "f8", (3,)),
        ("turn", "f8", (3, 3)),
        ("goal_pos", "f8", (3,)),
        ("goal_mat", "f8", (3, 3)),
        ("calls", "i8"),
        ("broken", "i8"),
    ],
    align=True,
)


class ArmControl:
    """The controller of one environment's arm: `step` advances its simulation by one control period.

    site, base: ids of the sites to be moved and of the arm's own origin.
    qpos, qvel, ctrl: (n,) indices of the arm.
    kp, kd: (6,) gains.
    scale: (6,) meters and radians that an action of 1 stands for.
    rest: (n,) rad, the posture that a redundant arm is drawn to.
    substeps: physics steps in a control period.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        *,
        site: int,
        base: int,
        qpos: Sequence[int],
        qvel: Sequence[int],
        ctrl: Sequence[int],
        kp: Array,
        kd: Array,
        scale: Array,
        rest: Array,
        substeps: int,
    ) -> None:
        joints = len(qvel)
        if joints > MOST_JOINTS:
            raise ValueError(f"an arm of {joints} joints; MOST_JOINTS is {MOST_JOINTS}")
        self._model, self._substeps, self._scale = model, substeps, np.asarray(scale, float)
        self._site, self._base = site, base
        self._record = np.zeros(1, _ARM_RECORD)
        record = self._record[0]
        record["nq"], record["nv"], record["nu"], record["nM"] = model.nq, model.nv, model.nu, model.nM
        record["joints"] = joints
        record["qpos_at"][:joints], record["qvel_at"][:joints], record["ctrl_at"][:joints] = qpos, qvel, ctrl
        record["moves_site"][:joints] = _movers(model, site, qvel)
        record["moves_base"][:joints] = _movers(model, base, qvel)  # an IIWA's is on its first link
        record["inertia_at"][:joints, :joints] = _inertia_addresses(model, qvel)
        record["torque_range"][:joints] = model.actuator_ctrlrange[ctrl]
        record["rest"][:joints], record["kp"], record["kd"] = rest, kp, kd
        self.use(data)

    def clone(self, data: mujoco.MjData) -> "ArmControl":
        """The same arm in another simulation of the same model."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin._record = self._record.copy()
        twin.use(data)
        return twin

    def use(self, data: mujoco.MjData) -> None:
        """Read and move this simulation from now on."""
        self._data, record = data, self._record[0]
        root = self._model.body_rootid[self._model.site_bodyid[self._site]]
        record["data"] = data._address
        for name, array in {
            "qpos": data.qpos,
            "qvel": data.qvel,
            "bias": data.qfrc_bias,
            "inertia": data.qM,
            "ctrl": data.ctrl,
            "dof_axes": data.cdof,
            "root_com": data.subtree_com[root],
            "site_pos": data.site_xpos[self._site],
            "site_mat": data.site_xmat[self._site],
            "base_pos": data.site_xpos[self._base],
            "base_mat": data.site_xmat[self._base],
        }.items():
            record[name] = array.ctypes.data

    def step(self, action: Array) -> None:
        """One control period towards the present pose moved by `action` (6,) in [-1, 1], in the base's frame.

        The rest of `data.ctrl` (a gripper's) is held as it is.

        Raises:
            SimulationDiverged: MuJoCo gave up, or the arm's inertia is no longer one.
        """
        record, delta = self._record[0], action * self._scale
        record["delta"] = delta[:3]
        # robosuite's own two functions, which round to single precision on the way.
        record["turn"] = transform_utils.quat2mat(transform_utils.axisangle2quat(delta[3:]))
        record["calls"] = record["broken"] = 0
        control, silence = _callbacks()
        with _STEPPING:
            control(0, self._record.ctypes.data)
            try:
                # Only around our own call: others may step models of theirs in this process.
                mujoco.set_mjcb_control(control)
                mujoco.set_mju_user_warning(silence)
                mujoco.mj_step(self._model, self._data, self._substeps)
            except mujoco.FatalError as error:  # more contacts than it can solve
                raise SimulationDiverged(str(error)) from error
            finally:
                mujoco.set_mjcb_control(None)
                mujoco.set_mju_user_warning(None)
        if record["broken"]:
            raise SimulationDiverged("the arm's inertia or pose is not finite")
        if record["calls"] != self._substeps:
            raise RuntimeError(
                f"controlled {record['calls']} of {self._substeps} substeps: MuJoCo's callback was taken"
            )


def _movers(model: mujoco.MjModel, site: int, dofs: Sequence[int]) -> list[bool]:
    """Which of the dofs move the site: those of its body and of that body's ancestors."""
    body, bodies = int(model.site_bodyid[site]), set()
    while body > 0:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return [int(model.dof_bodyid[dof]) in bodies for dof in dofs]


def _inertia_addresses(model: mujoco.MjModel, dofs: Sequence[int]) -> Array:
    """(n, n) where in `qM`, which keeps the lower triangle along each dof's ancestors, M[i, j] stands."""
    where = {}
    for dof in dofs:
        address, other = int(model.dof_Madr[dof]), int(dof)
        while other >= 0:
            where[int(dof), other] = where[other, int(dof)] = address
            address, other = address + 1, int(model.dof_parentid[other])
    return np.array([[where[int(i), int(j)] for j in dofs] for i in dofs])


@intrinsic  # type: ignore[untyped-decorator]
def _pointer(_context: Any, address: Any) -> Any:
    """An address as a pointer."""

    def make(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.int64), make


@intrinsic  # type: ignore[untyped-decorator]
def _mailbox(_context: Any) -> Any:
    """The address of a word that lies with the compiled code: one a process, and 0 at first."""

    def make(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        word = ir.IntType(64)
        kept = cgutils.add_global_variable(builder.module, word, "playlearn.mailbox")
        kept.linkage, kept.initializer = "internal", word(0)
        return builder.ptrtoint(kept, word)

    return types.int64(), make


def _control(model: Any, data: Any) -> None:
    """Write the arm's torques into `ctrl` of the arm whose turn it is, if this is its simulation's data.

    MuJoCo calls it with its model and data, we with 0 and the arm whose turn it is from now on. So the code holds no
    address of this process, and is compiled once for all.
    """
    mailbox = numba.carray(_pointer(_mailbox()), 1, np.int64)
    if model == 0:
        mailbox[0] = data
        return
    record = numba.carray(_pointer(mailbox[0]), 1, _ARM_RECORD)[0]
    if record.data != data:
        return  # another thread's simulation, which only happens to run meanwhile
    record.calls += 1
    ctrl = _floats(record.ctrl, record.nu)
    if record.calls == 1:
        _set_goal(record)
    try:
        torques = _torques(record)
        for i in range(record.joints):
            ctrl[record.ctrl_at[i]] = min(max(torques[i], record.torque_range[i, 0]), record.torque_range[i, 1])
    except Exception:  # noqa: BLE001 - numba knows no other; an inertia that has no inverse
        record.broken = 1


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _set_goal(record: Any) -> None:
    """The present pose, moved by delta and turn; kept in the base's frame."""
    from_base, from_world, hand = np.eye(4), np.eye(4), np.eye(4)
    base_mat = _floats(record.base_mat, (3, 3))
    from_base[:3, :3] = base_mat.T
    from_base[:3, 3] = np.dot(-np.ascontiguousarray(base_mat.T), _floats(record.base_pos, 3))
    from_world[:3, 3] = _floats(record.site_pos, 3)
    hand[:3, :3], hand[:3, 3] = _floats(record.site_mat, (3, 3)), _floats(record.site_pos, 3)
    record.goal_pos[:] = np.dot(from_base, from_world)[:3, 3] + record.delta
    record.goal_mat[:] = np.dot(record.turn.copy(), np.ascontiguousarray(np.dot(from_base, hand)[:3, :3]))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _torques(record: Any) -> Any:
    """(n,) N m, before the actuators' limits."""
    n, nv = record.joints, record.nv
    qpos, qvel, bias = _floats(record.qpos, record.nq), _floats(record.qvel, nv), _floats(record.bias, nv)
    inertia = _floats(record.inertia, record.nM)
    position, velocity, gravity, rest = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    mass = np.empty((n, n)).T  # Fortran order, as robosuite's indexing leaves it
    for i in range(n):
        position[i], velocity[i] = qpos[record.qpos_at[i]], qvel[record.qvel_at[i]]
        gravity[i], rest[i] = bias[record.qvel_at[i]], record.rest[i]
        for j in range(n):
            mass[i, j] = inertia[record.inertia_at[i, j]]
    jacobian = _jacobian(record, record.site_pos, record.moves_site)  # (6, nv)
    speed, spin = np.dot(jacobian[:3], qvel), np.dot(jacobian[3:], qvel)
    if record.moves_base.any():
        carried = _jacobian(record, record.base_pos, record.moves_base)
        speed, spin = speed - np.dot(carried[:3], qvel), spin - np.dot(carried[3:], qvel)
    arm = np.empty((6, n))
    for i in range(n):
        arm[:, i] = jacobian[:, record.qvel_at[i]]

    site_pos, site_mat = _floats(record.site_pos, 3), _floats(record.site_mat, (3, 3))
    base_pos, base_mat = _floats(record.base_pos, 3), _floats(record.base_mat, (3, 3))
    goal_pos = base_pos + np.dot(base_mat, record.goal_pos.copy())
    goal_mat = np.dot(base_mat, record.goal_mat.copy())
    force = (goal_pos - site_pos) * record.kp[:3] - speed * record.kd[:3]
    torque = orientation_error(goal_mat, site_mat) * record.kp[3:] - spin * record.kd[3:]
    _, linear, angular, nullspace = opspace_matrices(mass, arm, arm[:3], arm[3:])
    wrench = np.empty(6)
    wrench[:3], wrench[3:] = np.dot(linear, force), np.dot(angular, torque)
    torques = np.dot(arm.T, wrench) + gravity
    return torques + nullspace_torques(mass, nullspace, rest, position, velocity)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _jacobian(record: Any, where: int, moves: Any) -> Any:
    """(6, nv): how the arm's joints move a site, linear before angular, as `mj_jacSite` computes it."""
    axes, root, site = _floats(record.dof_axes, (record.nv, 6)), _floats(record.root_com, 3), _floats(where, 3)
    x, y, z = site[0] - root[0], site[1] - root[1], site[2] - root[2]
    jacobian = np.zeros((6, record.nv))
    for i in range(record.joints):
        if moves[i]:
            dof = record.qvel_at[i]
            axis = axes[dof]  # angular before linear, at the root's center of mass
            jacobian[0, dof] = axis[3] + (axis[1] * z - axis[2] * y)
            jacobian[1, dof] = axis[4] + (axis[2] * x - axis[0] * z)
            jacobian[2, dof] = axis[5] + (axis[0] * y - axis[1] * x)
            jacobian[3:, dof] = axis[:3]
    return jacobian


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _floats(address: int, shape: Any) -> Any:
    return numba.carray(_pointer(address), shape, np.float64)


def _silence(_message: Any) -> None:
    pass


_STEPPING = threading.Lock()  # one simulation is stepped at a time; the callback finds it through the mailbox


@functools.cache
def _callbacks() -> tuple[Any, Any]:
    """What MuJoCo calls for controls, and for warnings: they are counted, and need no MUJOCO_LOG.TXT in this folder."""
    control = numba.cfunc(types.void(types.int64, types.int64), cache=True)(_control)
    silence = numba.cfunc(types.void(types.int64), cache=True)(_silence)
    return control.ctypes, silence.ctypes
