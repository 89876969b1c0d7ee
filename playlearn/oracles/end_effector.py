"""The end effector as skills see and command it: the gripper's pose, and motions of it as actions.

The gripper points down. Its yaw is the direction of the finger axis (along which it opens): pi / 2 at
rest, kept within a quarter turn of that because a finger axis and its opposite are the same grasp.
"""

import math
from dataclasses import dataclass

import numpy as np

from playlearn.episode import Array, Observation

REST_YAW = np.pi / 2
STEP = 0.05  # meters that an action of 1 asks for
TURN = 0.5  # radians that an action of 1 asks for
OPEN, CLOSE = -1.0, 1.0


@dataclass(frozen=True)
class Style:
    """How skills are carried out.

    speed: fraction of full speed, in (0, 1].
    approach: meters above an object at which the end effector arrives.
    carry: meters at which an object is carried.
    """

    speed: float = 1.0
    approach: float = 0.07
    carry: float = 0.09


@dataclass(frozen=True, eq=False)
class EndEffector:
    """Pose and opening of the gripper.

    position: (3,) m.
    rotation: (3, 3).
    opening: meters between the finger pads.
    natural: yaw in rad in the middle of the wrist's range: across the direction in which the arm points.
    """

    position: Array
    rotation: Array
    opening: float
    natural: float = REST_YAW

    @classmethod
    def seen(cls, observation: Observation) -> "EndEffector":
        """From `observation.state` as `playlearn.sim.robosuite_env` lays it out."""
        state = observation.state.astype(float)
        a, b, c, d, e, f, opening = state[3:10].tolist()
        rotation = np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
        return cls(state[:3], rotation, opening)

    @property
    def yaw(self) -> float:
        """Direction of the finger axis, rad."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))

    def move(self, target: Array, yaw: float, grip: float, speed: float = 1.0) -> Array:
        """(7,) the action that moves towards target (3,) m and yaw rad, gripper pointing down."""
        low = self.natural - np.pi / 2
        yaw = low + ((yaw - low - 1e-6) % np.pi + 1e-6)
        c, s = float(np.cos(yaw)), float(np.sin(yaw))
        wanted = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
        return self.pose(target, wanted, grip, speed)

    def pose(self, target: Array, wanted: Array, grip: float, speed: float = 1.0) -> Array:
        """(7,) the action that moves towards target (3,) m and rotation (3, 3): finger axis, side, where it points."""
        turn = 0.5 * _crosses(self.rotation, wanted)
        if (np.trace(wanted @ self.rotation.T) - 1) / 2 < 0:  # beyond a quarter turn the sine shrinks again
            turn /= max(float(np.linalg.norm(turn)), 1e-6)
        shift = (target - self.position) / STEP
        reach = math.sqrt(shift @ shift)
        shift = shift * min(1.0, 1.0 / max(reach, 1e-9)) * speed
        turn = np.clip(turn / TURN, -0.8, 0.8) * speed
        action: Array = np.concatenate([shift, turn, [grip]]).clip(-1, 1)
        return action

    def yaw_error(self, yaw: float) -> float:
        """How far the finger axis is from `yaw`, rad in [0, pi / 2]."""
        off = abs(yaw - self.yaw) % np.pi
        return float(min(off, np.pi - off))


def _crosses(one: Array, other: Array) -> Array:
    """(3,) the cross products of the columns of two matrices (3, 3), added up; np.cross takes three times as long."""
    (ax, ay, az), (bx, by, bz) = one.tolist(), other.tolist()

    def added(a: list[float], b: list[float], c: list[float], d: list[float]) -> float:
        first, second, third = (a[i] * b[i] - c[i] * d[i] for i in range(3))
        return first + second + third

    return np.array([added(ay, bz, az, by), added(az, bx, ax, bz), added(ax, by, ay, bx)])
