"""The way back: from the displaced pose to where the recorded labels would have led, executed in the simulator."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from playlearn.collection.corrections.response import offset, undoing
from playlearn.episode import Array
from playlearn.errors import SimulationDiverged
from playlearn.sim import Environment

_LEFT = 0.5  # of a displacement, at most, when the way back is over
_NEAR = (2e-3, 2e-2)  # meters and radians that count as back, even for smaller displacements
_MOVED = 1e-3  # of what goals speak of: something was knocked


@runtime_checkable
class CorrectableEnv(Environment, Protocol):
    """An environment whose end effector can be displaced."""

    def displace(self, shift: Array, turn: Array) -> bool:
        """Move the end effector by `shift` (3,) m and the rotation vector `turn` (3,) rad, both in the world's frame.

        Only the arm's joints change; velocities stay. Returns whether it is there and touches nothing; if not, the
        environment is unusable until `set_state`.
        """
        ...

    def touching(self) -> bool:
        """Whether any part of the robot touches something that is not the robot."""
        ...


def way_back(
    env: CorrectableEnv, state: Array, labels: Array, response: Array, shift: Array, turn: Array
) -> Array | None:
    """(k, A) in [-1, 1]: the labels plus the correction that leads back; None where it did not lead back.

    At each step 2 / k of the remaining offset is commanded: a correction depends only on the current offset, not on the
    time since the displacement, so that a policy can learn it.

    state: of the simulator, before the displacement.
    labels: (k, A), recorded.
    response: see `end_effector_response`.
    shift: (3,) m.
    turn: (3,) rad.
    """
    names, steps = env.spec.state_names, len(labels)
    try:
        path, achieved = _replay(env, state, labels)
        env.set_state(np.array(state))
        if not env.displace(shift, turn):
            return None
        corrected = labels.astype(float)
        off = first = offset(names, env.observe().state, path[0])
        for j in range(steps):
            corrected[j, :6] = (corrected[j, :6] + undoing(response, off) * 2 / steps).clip(-1, 1)
            env.step(corrected[j])
            off = offset(names, env.observe().state, path[j + 1])
    except SimulationDiverged:
        return None
    for part, near in zip((slice(0, 3), slice(3, 6)), _NEAR, strict=True):
        if np.linalg.norm(off[part]) > max(_LEFT * float(np.linalg.norm(first[part])), near):
            return None
    if np.abs(env.observe().achieved - achieved).max() > _MOVED:
        return None
    return corrected.astype(np.float32)


def _replay(env: CorrectableEnv, state: Array, labels: Sequence[Array] | Array) -> tuple[list[Array], Array]:
    """The k+1 states of the robot along the recorded labels, and what was achieved in the end."""
    env.set_state(np.array(state))
    path = [env.observe().state]
    for label in labels:
        env.step(label)
        path.append(env.observe().state)
    return path, env.observe().achieved
