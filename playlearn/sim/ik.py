"""The end effector moved a little aside, the rest of the simulation as it was: damped least squares over the arm.

    dq = J^T (J J^T + damping^2 I)^-1 e         (Nakamura and Hanafusa, 1986; Wampler, 1986)

with e (6,) the error of the end effector's pose and J (6, n) the arm's Jacobian at its site.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from playlearn.episode import Array

_DAMPING = 0.05
_ROUNDS = 30
_WITHIN = (5e-4, 2e-3)  # meters and radians of error that are accepted


def displace(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    site: int,
    qpos: Sequence[int] | Array,
    qvel: Sequence[int] | Array,
    shift: Array,
    turn: Array,
) -> bool:
    """See `RobosuiteEnv.displace`. qpos, qvel: (n,) indices of the arm's hinges."""
    mujoco.mj_kinematics(model, data)
    place = data.site_xpos[site] + shift
    facing: Array = _rotation(turn) @ data.site_xmat[site].reshape(3, 3)
    ranges = model.jnt_range[model.dof_jntid[qvel]]  # (n, 2)
    jacobian = np.zeros((6, model.nv))
    for _ in range(_ROUNDS):
        lack = np.concatenate([place - data.site_xpos[site], _between(data.site_xmat[site].reshape(3, 3), facing)])
        if np.linalg.norm(lack[:3]) < _WITHIN[0] and np.linalg.norm(lack[3:]) < _WITHIN[1]:
            return True
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        arm = jacobian[:, qvel]  # (6, n)
        step = arm.T @ np.linalg.solve(arm @ arm.T + _DAMPING**2 * np.eye(6), lack)
        data.qpos[qpos] = np.clip(data.qpos[qpos] + step, ranges[:, 0], ranges[:, 1])
        mujoco.mj_kinematics(model, data)
    return False


def touching(model: mujoco.MjModel, data: mujoco.MjData, site: int) -> bool:
    """Whether the robot that bears the site touches what is not part of it, at the positions of `data`."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    root = model.body_rootid[model.site_bodyid[site]]
    own = model.body_rootid[model.geom_bodyid[data.contact.geom]] == root  # (contacts, 2)
    return bool((own[:, 0] != own[:, 1]).any())


def _rotation(turn: Array) -> Array:
    """(3, 3) of a rotation vector (3,) rad."""
    quaternion, matrix = np.empty(4), np.empty(9)
    angle = float(np.linalg.norm(turn))
    mujoco.mju_axisAngle2Quat(quaternion, np.asarray(turn, float) / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _between(now: Array, wanted: Array) -> Array:
    """(3,) rad, the rotation vector in the world frame that turns one into the other."""
    quaternion, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(wanted @ now.T).reshape(9))
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector
