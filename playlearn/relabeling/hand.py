"""What the hand does on the way to a settled moment: labels that every recording holds, of what only images show.

Where the gripper next closes is where the object is; where it is once the world has settled is where the object went
(affordances from gripper events in play: VAPO, Borja-Diaz et al. 2022). Of the closings before a settled moment the
last one counts: those before it missed.

    gripper    open  | closed  | open |  closed          | open
    closings         ^ missed         ^ grasp
    settled                                              ^ m
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from playlearn.batch import EVENTS
from playlearn.episode import Array
from playlearn.relabeling.index import Indices, RelabelIndex
from playlearn.relabeling.robot import RobotReader


def grasps(table: RelabelIndex, reader: RobotReader, states: Sequence[Array]) -> Indices:
    """(M,) the observation of the last closing up to each settled moment and after the one before it; -1 for none.

    states: (T+1, S) of each episode.
    """
    found = np.full(len(table.moments), -1, np.int64)
    for episode, state in enumerate(states):
        closings, before = reader.closings(state), 0
        for flat in range(table.offsets[episode], table.offsets[episode + 1]):
            moment = int(table.moments[flat])
            own = closings[(closings > before) & (closings <= moment)]
            if len(own):
                found[flat] = own[-1]
            before = moment
    return found


def events_ahead(table: RelabelIndex, closed: Indices, episodes: Indices, t: Indices) -> NDArray[np.int64]:
    """(n, 2) the observation of each of `EVENTS` after step t, on the way to the next settled moment; -1 for none.

    closed: (M,) of `grasps`.
    """
    following = table.following(episodes, t)
    there = following < table.offsets[episodes + 1]
    at = np.where(there, following, 0)
    if not len(table.moments):
        return np.full((len(t), len(EVENTS)), -1, np.int64)
    both = np.stack([closed[at], table.moments[at]], axis=1)
    return np.where(there[:, None] & (both > t[:, None]), both, -1)
