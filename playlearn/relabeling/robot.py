"""Settled moments of recordings without `achieved`, a real robot's: read from the gripper and the arm's motion.

What a hand lets go of stays where it was put, and where an arm that has hold of something stops, something is
shown. So the world has settled, as far as the robot can tell,

- when the gripper has opened after it had closed: `gripper.opened`;
- when the arm comes to rest with its gripper closed, and has moved since that closed or since the last moment
  (an open hand that stops in mid-air has changed nothing): `arm.stopped`.

Against the moments read from `achieved` in simulated play on PlayTable (300 episodes, 1,264 moments): 73 % of those
found here have one within 0.5 s, and 80 % of them are found; 81 % of those found show a world that had settled since
the one before (within 0.5 s of the time that it lasted), and 88 % of those worlds are shown. Missed is above all what
a closed hand does in passing, a button pressed or a lever turned without a stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.relabeling.calibrate import measure, ranges

NAMES = ("gripper.opened", "arm.stopped")  # what a moment of the robot's says has changed


@dataclass(frozen=True)
class RobotConfig:
    """Which numbers of `observation.state` are what; their thresholds are measured (see `measure.measure`).

    gripper: shell-style patterns; the first name that matches says how far the gripper is open, more being wider.
    arm: patterns of the arm's place; where none matches, everything but the gripper.
    rest_seconds: for how long the arm stands still where it has come to rest; it pauses on its way, too.
    """

    gripper: tuple[str, ...] = ("*gripper*",)
    arm: tuple[str, ...] = ("eef.x", "eef.y", "eef.z")
    rest_seconds: float = 0.5

    def columns(self, names: Sequence[str]) -> tuple[list[int], list[int]]:
        """Of the state's names the gripper's, one or none, and the arm's."""
        grippers, arm = (
            [k for k, name in enumerate(names) if any(fnmatchcase(name, pattern) for pattern in patterns)]
            for patterns in (self.gripper, self.arm)
        )
        return grippers[:1], arm or [k for k in range(len(names)) if k not in grippers]


@dataclass(frozen=True, eq=False)
class RobotReader:
    """Finds the moments in states (T+1, S).

    gripper, arm: columns. opens: by how much the gripper opens or closes before it has. middle: of the openings
    seen, below which a recording begins with it closed. moves, rests (arm,): how far the arm gets before it has
    moved, and within what it stays at rest over `window` steps.
    """

    gripper: list[int]
    arm: list[int]
    opens: float
    middle: float
    moves: NDArray[np.float64]
    rests: NDArray[np.float64]
    window: int

    @classmethod
    def measured(cls, states: Sequence[Array], names: Sequence[str], fps: float, config: RobotConfig) -> Self:
        """With the thresholds of this play."""
        gripper, arm = config.columns(names)
        window = max(1, round(config.rest_seconds * fps))
        openings = [_openings(state, gripper) for state in states]
        opens, _ = measure([own[:, None] for own in openings], ("opening",), fps, window)
        middle = np.quantile(np.concatenate(openings), [0.05, 0.95]).mean()
        moves, rests = measure([state[:, arm] for state in states], [names[k] for k in arm], fps, window)
        return cls(gripper, arm, float(opens[0]), float(middle), moves, rests, window)

    def __call__(self, state: Array) -> tuple[list[int], list[int], list[list[bool]]]:
        """The moments (m), the last observation each holds to, and which of `NAMES` each is (m, 2)."""
        openings = _openings(state, self.gripper)
        closed = self._closed(openings.tolist())
        turns = np.flatnonzero(np.diff(closed)) + 1  # each first observation with the hand closed, or open, again
        grasps = set(turns[closed[turns]].tolist())
        opened = {
            begin + int((openings[begin:end] >= openings[begin:end].max() - self.opens).argmax())
            for begin, end in pairwise([*turns.tolist(), len(state)])
            if not closed[begin]
        }
        arm = np.asarray(state[:, self.arm], np.float64)
        resting = np.zeros(len(arm), np.bool_)
        if len(arm) > self.window:
            resting[self.window :] = (ranges(arm, self.window) < self.rests).all(axis=1)
        moments: list[int] = []
        came_from = arm[0]  # where the arm was at the last moment or grasp
        for t in sorted({*grasps, *opened, *np.flatnonzero(resting & closed).tolist()}):
            stopped = t not in grasps and bool((np.abs(arm[t] - came_from) > self.moves).any())
            if t in opened or stopped:
                moments.append(t)
            if t in opened or stopped or t in grasps:
                came_from = arm[t]
        ends = [min(self._end(arm, closed, t), other - 1) for t, other in pairwise([*moments, len(arm)])]
        return moments, ends, [[t in opened, t not in opened] for t in moments]

    def _closed(self, openings: Sequence[float]) -> NDArray[np.bool_]:
        """(T+1,) whether the gripper is closed: once it closed by `opens` from its widest, until it opens as much."""
        closed, furthest, states = openings[0] <= self.middle, openings[0], []
        for opening in openings:
            furthest = min(furthest, opening) if closed else max(furthest, opening)
            if abs(opening - furthest) > self.opens:
                closed, furthest = not closed, opening
            states.append(closed)
        return np.array(states, np.bool_)

    def _end(self, arm: Array, closed: NDArray[np.bool_], t: int) -> int:
        """What was let go of stays until the hand closes again; what is held, until the arm moves on."""
        leaves = (np.abs(arm[t:] - arm[t]) > self.rests).any(axis=1) if closed[t] else closed[t:]
        return t + int(leaves.argmax()) - 1 if leaves.any() else len(arm) - 1


def _openings(state: Array, gripper: Sequence[int]) -> NDArray[np.float64]:
    """(T+1,) how far the gripper is open; 0 throughout where there is none."""
    return np.asarray(state[:, gripper[0]], np.float64) if gripper else np.zeros(len(state))
