"""Operational-space control of an arm, compiled: the law that robosuite runs in Python 500 times a second.

    tau = J^T [L_p (kp e_p - kd v_p); L_r (kp e_r - kd v_r)] + g(q) + N^T M (k (q0 - q) - 2 sqrt(k) qd)

with L the task-space inertias of position and orientation, decoupled, and N the null space of J
(Khatib, 1987; gains and decoupling as robosuite's OSC_POSE).
"""

import math

import numba
import numpy as np

from playlearn.episode import Array

NULLSPACE_STIFFNESS = 10.0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def osc_torques(
    mass: Array,
    jacobian: Array,
    bias: Array,
    position_error: Array,
    orientation_error: Array,
    kp: Array,
    kd: Array,
    joint_position: Array,
    joint_velocity: Array,
    rest_position: Array,
) -> Array:
    """Joint torques (n,) N m for mass (n, n), jacobian (6, n), bias (n,) and the six task errors."""
    joints = mass.shape[0]
    mass_inverse = np.linalg.inv(mass)
    velocity = jacobian @ joint_velocity  # (6,)
    half = jacobian @ mass_inverse  # (6, n)
    inertia_inverse = half @ jacobian.T  # (6, 6)
    force = kp[:3] * position_error - kd[:3] * velocity[:3]
    torque = kp[3:] * orientation_error - kd[3:] * velocity[3:]
    wrench = np.empty(6)
    wrench[:3] = np.linalg.solve(np.ascontiguousarray(inertia_inverse[:3, :3]), force)
    wrench[3:] = np.linalg.solve(np.ascontiguousarray(inertia_inverse[3:, 3:]), torque)
    posture = mass @ (
        NULLSPACE_STIFFNESS * (rest_position - joint_position) - 2.0 * math.sqrt(NULLSPACE_STIFFNESS) * joint_velocity
    )
    inertia = np.linalg.pinv(inertia_inverse)
    nullspace = np.eye(joints) - (half.T @ inertia) @ jacobian  # (n, n)
    torques: Array = jacobian.T @ wrench + bias + nullspace.T @ posture
    return torques


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def rotation_error(desired: Array, current: Array) -> Array:
    """Small-angle rotation (3,) rad that takes `current` (3, 3) towards `desired` (3, 3)."""
    error = np.zeros(3)
    for column in range(3):
        a0, a1, a2 = current[0, column], current[1, column], current[2, column]
        b0, b1, b2 = desired[0, column], desired[1, column], desired[2, column]
        error[0] += 0.5 * (a1 * b2 - a2 * b1)
        error[1] += 0.5 * (a2 * b0 - a0 * b2)
        error[2] += 0.5 * (a0 * b1 - a1 * b0)
    return error
