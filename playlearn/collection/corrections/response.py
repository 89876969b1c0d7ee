"""How far the end effector moves for an action, measured on play; and which actions undo a displacement."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.store import Store

_LAGS = 8  # steps within which an action has had its after
_POSITION = ("eef.x", "eef.y", "eef.z")
_AXES = ("eef.r00", "eef.r10", "eef.r20", "eef.r01", "eef.r11", "eef.r21")
_MOVES = ("dx", "dy", "dz", "droll", "dpitch", "dyaw")


def end_effector_response(store: Store, episodes: Sequence[int]) -> Array:
    """(2, 3, 3): meters of displacement, and radians of rotation, that an action of 1 adds up to in the end.

    Each step's motion is fitted linearly on the actions before it, and the fit is summed over the lags. Of that sum the
    nearest rotation is taken (the arm's base may be rotated), times the median of its three gains: an axis that was
    moved only to hold it still would seem to respond less. A controller that sets its goal relative to the current
    pose, as OSC_POSE does with deltas, moves much less far than commanded.

    episodes: positions in the store.

    Raises:
        UsageError: state or action lack the end effector's pose.
    """
    names, moves = store.spec.state_names, store.spec.action_names
    lacking = [name for name in (*_POSITION, *_AXES) if name not in names] + [m for m in _MOVES if m not in moves]
    if lacking:
        raise UsageError(
            f"corrections need the end effector's pose and motion; {store.name()} has no {', '.join(lacking)}"
        )
    where, axes = _pose_indices(names)
    commanded = [moves.index(name) for name in _MOVES]
    actions: list[list[Array]] = [[], []]
    motions: list[list[Array]] = [[], []]
    for i in episodes:
        state = store.array(int(i), "observation.state").astype(float)
        action = store.array(int(i), "action")[:, commanded].astype(float)
        if len(action) < _LAGS:
            continue
        motion = np.diff(state[:, where], axis=0), _rotations(state[:, axes])
        lagged = np.stack([action[_LAGS - 1 - lag : len(action) - lag] for lag in range(_LAGS)], axis=1)  # (n, L, 6)
        for kind in range(2):
            actions[kind].append(lagged[:, :, 3 * kind : 3 * kind + 3].reshape(len(lagged), -1))
            motions[kind].append(motion[kind][_LAGS - 1 :])
    if not actions[0]:
        raise UsageError(f"{store.name()}: its episodes are too short to measure how the end effector responds")
    fits = [
        np.linalg.lstsq(np.concatenate(before), np.concatenate(after), rcond=None)[0]  # (L 3, 3)
        for before, after in zip(actions, motions, strict=True)
    ]
    return np.stack([_isotropic(fit.reshape(_LAGS, 3, 3).sum(axis=0).T) for fit in fits])


def offset(names: Sequence[str], state: Array, other: Array) -> Array:
    """(6,) m and rad: from the end effector in `other` (S,) to that in `state` (S,); small rotations only."""
    where, axes = _pose_indices(names)
    return np.concatenate([state[where].astype(float) - other[where], _rotations(np.stack([other, state])[:, axes])[0]])


def undoing(response: Array, off: Array) -> Array:
    """(6,) the sum of actions that undoes a displacement (6,). response: see `end_effector_response`."""
    return -np.concatenate([np.linalg.solve(response[0], off[:3]), np.linalg.solve(response[1], off[3:])])


def _pose_indices(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """The indices of the end effector's position and orientation in a state."""
    return [names.index(name) for name in _POSITION], [names.index(name) for name in _AXES]


def _isotropic(gain: Array) -> Array:
    """(3, 3) the rotation of `gain` with the same gain along each axis."""
    left, sizes, right = np.linalg.svd(gain)
    return np.asarray(left @ right * np.median(sizes))


def _rotations(axes: Array) -> Array:
    """(T, 3) rad: the rotation vectors between T+1 orientations, each given by the first two columns of its matrix."""
    first, second = axes[:, :3].astype(float), axes[:, 3:].astype(float)
    matrices = np.stack([first, second, np.cross(first, second)], axis=2)  # (T+1, 3, 3)
    between = matrices[1:] @ matrices[:-1].transpose(0, 2, 1)
    # Small rotations: the vector is the skew part.
    skew = between - between.transpose(0, 2, 1)
    return 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
