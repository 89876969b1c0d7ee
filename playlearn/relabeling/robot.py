"""Settled moments of recordings without `achieved`, a real robot's: read from the gripper and the arm's motion.

An object stays where a gripper released it, and an arm that stops while it holds an object has placed it. So a moment
is taken as settled

- when the gripper has opened after it had closed: `gripper.opened`;
- when the arm comes to rest with its gripper closed, and has moved since it closed or since the last settled moment
  (an open gripper that stops in mid-air has changed nothing): `arm.stopped`.

Against the moments read from `achieved` in simulated play on PlayTable (300 episodes, 1,264 moments): precision 73 %,
recall 80 % (within 0.5 s). By configurations: 81 % of the moments found show one that had settled since the moment
before (within 0.5 s of its duration), and 88 % of those configurations are shown. Mostly missed is what a closed
gripper does in passing: a button pressed or a lever turned without a stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.quantity import continuous, difference, subset
from playlearn.relabeling.calibrate import measure, ranges

NAMES = ("gripper.opened", "arm.stopped")  # what changes at a settled moment that is read from the robot


@dataclass(frozen=True)
class RobotConfig:
    """Which dimensions of `observation.state` are gripper and arm; thresholds are measured (see `calibrate.measure`).

    gripper: shell-style patterns, upper case like lower; the first name that matches is the gripper's.
    gripper_closes: whether the gripper reads a low number when it is closed, as most do, or a high one; no recording
        says which.
    arm: patterns of the arm's position; where none matches, everything but grippers.
    rest_seconds: for how long the arm is still before it counts as at rest, since it also pauses on its way.
    """

    gripper: tuple[str, ...] = ("*gripper*",)
    gripper_closes: Literal["low", "high"] = "low"
    arm: tuple[str, ...] = ("eef.x", "eef.y", "eef.z")
    rest_seconds: float = 0.5

    def columns(self, names: Sequence[str]) -> tuple[list[int], list[int]]:
        """The dimensions of the gripper, one or none, and of the arm, by the names of the state."""
        grippers, arm = _matching(names, self.gripper), _matching(names, self.arm)
        return grippers[:1], arm or [k for k in range(len(names)) if k not in grippers]

    def describe(self, names: Sequence[str]) -> str:
        """What settled moments are read from, and what was not found, by the names of the state."""
        grippers, (first, columns) = _matching(names, self.gripper), self.columns(names)
        arm = ", ".join(names[k] for k in columns) or "none"
        setting = "`data.settling.robot.gripper`"
        if not first:
            patterns = ", ".join(self.gripper)
            return (
                f"no gripper ({patterns}): every stop of the arm ({arm}) counts as settled, unless {setting} names it"
            )
        others = ", ".join(names[k] for k in grippers[1:])
        found = [
            f"settled where the gripper ({names[first[0]]}) has opened or, closed, the arm ({arm}) stops",
            f"it is closed where it reads {self.gripper_closes} (`data.settling.robot.gripper_closes`)",
        ]
        if others:
            found.append(f"one gripper is read, and not {others}: {setting} and `.arm` can name another and its arm")
        return "; ".join(found)


@dataclass(frozen=True, eq=False)
class RobotReader:
    """Finds the moments in states (T+1, S).

    gripper: its dimension of the state, or none.
    widens: 1 where the gripper reads more as it opens, else -1.
    arm: its dimensions.
    opens: by how much the gripper's opening changes before it counts as opened or closed.
    middle: between the widest and the narrowest opening; a recording that begins below it begins closed.
    moves: (arm,) how far the arm moves before it has moved.
    rests: (arm,) the range within which it stays at rest.
    window: steps for which it must stay there.
    declared: (arm,) what its dimensions measure, "" where nobody said.
    """

    gripper: list[int]
    widens: int
    arm: list[int]
    opens: float
    middle: float
    moves: NDArray[np.float64]
    rests: NDArray[np.float64]
    window: int
    declared: tuple[str, ...]

    @classmethod
    def measured(
        cls, states: Sequence[Array], names: Sequence[str], declared: Sequence[str], fps: float, config: RobotConfig
    ) -> Self:
        """With thresholds measured on these states.

        names: (S,).
        declared: (S,) what each dimension measures, "" where nobody said.
        """
        gripper, arm = config.columns(names)
        window = max(1, round(config.rest_seconds * fps))
        widens = 1 if config.gripper_closes == "low" else -1
        openings = [_openings(state, gripper, widens) for state in states]
        opens, _ = measure([own[:, None] for own in openings], subset(declared, gripper) or ("",), fps, window)
        middle = np.quantile(np.concatenate(openings), [0.05, 0.95]).mean()
        own = subset(declared, arm)
        moves, rests = measure([state[:, arm] for state in states], own, fps, window)
        return cls(gripper, widens, arm, float(opens[0]), float(middle), moves, rests, window, own)

    def __call__(self, state: Array) -> tuple[list[int], list[int], list[list[bool]]]:
        """The moments (m), the last observation each holds to, and which of `NAMES` each is (m, 2)."""
        openings = _openings(state, self.gripper, self.widens)
        closed = self._closed(openings.tolist())
        turns = np.flatnonzero(np.diff(closed)) + 1  # each first observation with the gripper closed, or open, again
        grasps = set(turns[closed[turns]].tolist())
        opened = {
            begin + int((openings[begin:end] >= openings[begin:end].max() - self.opens).argmax())
            for begin, end in pairwise([*turns.tolist(), len(state)])
            if not closed[begin]
        }
        arm = np.asarray(state[:, self.arm], np.float64)
        resting = np.zeros(len(arm), np.bool_)
        if len(arm) > self.window:
            resting[self.window :] = (ranges(continuous(arm, self.declared), self.window) < self.rests).all(axis=1)
        moments: list[int] = []
        came_from = arm[0]  # where the arm was at the last moment or grasp
        for t in sorted({*grasps, *opened, *np.flatnonzero(resting & closed).tolist()}):
            stopped = t not in grasps and bool((self._distance(arm[t], came_from) > self.moves).any())
            if t in opened or stopped:
                moments.append(t)
            if t in opened or stopped or t in grasps:
                came_from = arm[t]
        ends = [min(self._end(arm, closed, t), other - 1) for t, other in pairwise([*moments, len(arm)])]
        return moments, ends, [[t in opened, t not in opened] for t in moments]

    def closings(self, state: Array) -> NDArray[np.int64]:
        """(k,) the observations of (T+1, S) at which the gripper has closed, the first one left out."""
        closed = self._closed(_openings(state, self.gripper, self.widens).tolist())
        return np.flatnonzero(closed[1:] & ~closed[:-1]) + 1

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
        """The last observation of t's configuration: until the gripper closes; while closed, until the arm moves."""
        leaves = (self._distance(arm[t:], arm[t]) > self.rests).any(axis=1) if closed[t] else closed[t:]
        return t + int(leaves.argmax()) - 1 if leaves.any() else len(arm) - 1

    def _distance(self, one: Array, other: Array) -> Array:
        return np.asarray(np.abs(difference(one, other, self.declared)))


def _matching(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """The dimensions whose name matches one of the patterns, upper case like lower."""
    lower = [pattern.lower() for pattern in patterns]
    return [k for k, name in enumerate(names) if any(fnmatchcase(name.lower(), pattern) for pattern in lower)]


def _openings(state: Array, gripper: Sequence[int], widens: int) -> NDArray[np.float64]:
    """(T+1,) how far the gripper is open, more being wider; 0 throughout where there is none."""
    return widens * np.asarray(state[:, gripper[0]], np.float64) if gripper else np.zeros(len(state))
