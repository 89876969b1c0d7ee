"""Which numbers about objects depend on the hand: they change with it while nothing else does.

robosuite, for one, observes a cube by its place and by its place relative to the gripper. The latter changes wherever
the hand goes and comes to rest wherever it rests, so that a cube that nobody touches would seem to have moved.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array

SHORTEST = 24  # observations in the opening of an episode
SET_OUT = 0.3  # of its range in the recordings: how far some part of the robot goes in the opening
CHANGED = 0.05  # of its range: how far a dimension changes there
STILL = 0.01  # of its range: within what it rests
REST = 5  # observations
# Shares: of the variance of the robot's motion, in its main directions; of a dimension's variance, explained by it; of
# the episodes in which that is so. The last line is for a robot that never rests, as all that is smooth looks alike.
SHARES = (0.98, 0.95, 0.3)
SHARES_OF_SMOOTH = (0.9999, 0.999, 0.6)
PER_DIRECTION = 4  # observations, at least, for each direction of motion that may explain them
AT_MOST = 50  # episodes that are looked at


def moves_with_hand(objects: Sequence[Array], robot: Sequence[Array]) -> NDArray[np.bool_]:
    """(G,) which dimensions of `objects`, an (n, G) an episode, depend on the robot, of which `robot` is the (n, S).

    An object lies still while a hand approaches it. So the opening of each episode is read, in which the robot sets
    out: a dimension depends on it if it changes there in many episodes, is a linear function of the robot's motion, and
    rests whenever the robot does. What the robot holds from the start is found, too. Where the robot never moves,
    nothing is known, and all are False.
    """
    chosen = np.unique(np.linspace(0, len(objects) - 1, min(len(objects), AT_MOST)).round().astype(int))
    objects, robot = ([np.asarray(rows[i], np.float64) for i in chosen] for rows in (objects, robot))
    scale, reach = _range(objects), _range(robot)
    together, rests = _rest_together(objects, robot, scale, reach)
    moved, explained, often = SHARES if rests else SHARES_OF_SMOOTH
    votes, openings = np.zeros(scale.shape), 0
    for own, rows in zip(objects, robot, strict=True):
        if n := _opening(rows / reach):
            votes += _explained(own[:n] / scale, rows[:n] / reach, moved, explained)
            openings += 1
    return np.asarray(together & (votes >= max(often * openings, 1)))


def _range(rows: Sequence[Array]) -> Array:
    """The range of each dimension over all episodes, 1 for one that never changes."""
    low, high = (np.stack([extreme(one, axis=0) for one in rows]) for extreme in (np.min, np.max))
    size: Array = high.max(axis=0) - low.min(axis=0)
    return np.where(size > 1e-9, size, 1.0)


def _opening(robot: Array) -> int:
    """How many observations pass until some part of the robot has set out; 0 if none does, or too late."""
    away = np.flatnonzero((np.abs(robot - robot[0]) > SET_OUT).any(axis=1))
    length = max(SHORTEST, int(away[0]) + 1) if len(away) else 0
    return length if length <= max(SHORTEST, len(robot) // 2) and length <= len(robot) else 0


def _explained(own: Array, robot: Array, moved: float, share: float) -> NDArray[np.bool_]:
    """(G,) what changes in an opening (n, G), and is a linear function of the robot's motion (n, S).

    moved: share of the motion's variance that is looked at.
    share: of a dimension's variance that it must explain.
    """
    directions, size, _ = np.linalg.svd(robot - robot.mean(axis=0), full_matrices=False)
    power = np.cumsum(np.square(size))
    count = min(int(np.searchsorted(power, moved * power[-1])) + 1, len(own) // PER_DIRECTION)
    motion = directions[:, :count]
    values = own - own.mean(axis=0)
    left = np.square(values - motion @ (motion.T @ values)).sum(axis=0)
    return np.asarray((np.ptp(own, axis=0) > CHANGED) & (left <= (1 - share) * np.square(values).sum(axis=0)))


def _rest_together(
    objects: Sequence[Array], robot: Sequence[Array], scale: Array, reach: Array
) -> tuple[NDArray[np.bool_], int]:
    """(G,) whether a dimension rests in nearly all windows in which the robot does; and how many these are."""
    still, windows = np.zeros(scale.shape), 0
    for own, rows in zip(objects, robot, strict=True):
        for begin in range(0, len(rows) - REST + 1, REST):
            part = slice(begin, begin + REST)
            if (np.ptp(rows[part], axis=0) < STILL * reach).all():
                still += np.ptp(own[part], axis=0) < 2 * STILL * scale
                windows += 1
    return still >= 0.9 * windows, windows
