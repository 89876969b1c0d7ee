"""What every environment refuses: an invalid action, and physics that has diverged."""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from playlearn.episode import Array
from playlearn.errors import ActionError, SimulationDiverged

_FATAL = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]


def checked_action(action: Array, names: Sequence[str]) -> Array:
    """(A,) float64 in [-1, 1]; raises ActionError where it is of another shape, not finite or out of range."""
    action = np.asarray(action, float)
    if action.shape != (len(names),):
        raise ActionError(f"an action must have shape ({len(names)},), got {action.shape}")
    if not np.abs(action).max() <= 1 + 1e-6:  # nor is what is no number
        if not np.isfinite(action).all():
            raise ActionError(f"the action is not finite: {dict(zip(names, action.tolist(), strict=True))}")
        raise ActionError(f"actions lie in [-1, 1], got {action.round(3).tolist()}")
    return action.clip(-1, 1)


def check_physics(data: Any, before: float) -> None:
    """Raises SimulationDiverged where the step of an MjData that began at `before` s left physics, which is silent."""
    counts = data.warning.number
    finite = math.isfinite(data.qpos.sum() + data.qvel.sum())
    if counts[_FATAL].any() or data.time <= before or not finite:
        fired = [mujoco.mjtWarning(warning).name for warning in _FATAL if counts[warning]]
        counts[:] = 0
        raise SimulationDiverged(
            f"the simulation diverged at {before:.2f} s ({', '.join(fired) or 'not finite or time went back'}); "
            "the episode ends before it"
        )
