"""Settled moments of recordings without `achieved`, a real robot's: read from the gripper and the arm's motion.

An object stays where a gripper released it, and an arm that stops while it holds an object has placed it. So a moment
is taken as settled

- when the gripper has opened after it had closed: `gripper.opened`;
- when the arm comes to rest with its gripper closed: `arm.stopped` (an open gripper that stops in mid-air has changed
  nothing).

Both count only if the arm has moved since the gripper closed or since the last settled moment, until the fingers begin
to open: a grasp that failed, and a release where the arm had already stopped, change nothing. Nor does a gripper that
was closed for less than 0.2 s. Where the arm moves before hardly any opening, each counts.

`playlearn bench settled` measures it against the moments read from `achieved`, in two readings. By moments: the
fraction of the moments found with a true one within 0.5 s, and the other way round. By configurations: a moment found
shows a configuration if it lies within 0.5 s of its duration, one moment each; precision is the fraction of the moments
found that show one, recall the fraction of the configurations that are shown. See eval/results/settled.md.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.quantity import continuous, difference, subset
from playlearn.relabeling.calibrate import measure, ranges

NAMES = ("gripper.opened", "arm.stopped")  # what changes at a settled moment that is read from the robot
HELD_SECONDS = 0.2  # a gripper that opens sooner after it closed has grasped nothing
ENDS = (0.05, 0.95)  # quantiles of the opening that stand for shut and wide
OPENS_OF_RANGE = 0.1  # of the way between them: fingers that touch something tremble by less
CARRIES = 0.25  # of the openings: where the arm moves before fewer, its motion tells nothing, and each opening counts
FEW = 2  # one opening tells nothing of others
CLEAR = 0.8  # the fraction of holds that have to agree on where a gripper closes


@dataclass(frozen=True)
class RobotConfig:
    """Which dimensions of `observation.state` are gripper and arm; thresholds are measured (see `calibrate.measure`).

    gripper: shell-style patterns, upper case like lower; the first name that matches is the gripper's opening.
    gripper_closes: at `low` or at `high` numbers; null: measured (see `_closes_high`), and `low` where play does not
        tell.
    arm: patterns of the arm's position; where none matches, everything but grippers.
    rest_seconds: for how long the arm is still before it counts as at rest, since it also pauses on its way.
    """

    gripper: tuple[str, ...] = ("*gripper*",)
    gripper_closes: Literal["low", "high"] | None = None
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
        closes = self.gripper_closes or "low, unless the play tells otherwise"
        found = [
            f"settled where the gripper ({names[first[0]]}) has opened or, closed, the arm ({arm}) stops",
            f"it is closed where it reads {closes} (`data.settling.robot.gripper_closes`)",
        ]
        if others:
            found.append(f"one gripper is read, and not {others}: {setting} and `.arm` can name another and its arm")
        return "; ".join(found)


@dataclass(frozen=True)
class Grasp:
    """What happened between a closing of the gripper and its opening.

    closed: the first observation with the gripper closed.
    until: the last before its fingers begin to open.
    holds: something kept it from shutting.
    stops: settled moments at which the arm had come to rest.
    opened: the settled moment at which it had opened; None where it stayed closed or had changed nothing.
    """

    closed: int
    until: int
    holds: bool
    stops: tuple[int, ...]
    opened: int | None

    def moments(self) -> list[int]:
        """All settled moments."""
        return [*self.stops, *([] if self.opened is None else [self.opened])]


@dataclass(frozen=True, eq=False)
class RobotReader:
    """Finds the moments in states (T+1, S).

    gripper: its dimension of the state, or none.
    sign: -1.0 where a higher number is narrower, else 1.0.
    arm: its dimensions.
    opens: by how much the gripper's opening changes before it counts as opened or closed.
    still: the range within which the opening stays while the fingers do not move.
    shut: its narrowest opening.
    middle: between the widest and the narrowest opening; a recording that begins below it begins closed.
    moves: (arm,) how far the arm moves before it has moved.
    rests: (arm,) the range within which it stays at rest.
    window: steps for which it must stay there.
    held: steps for which a gripper is closed before its opening counts.
    carries: whether an opening counts only if the arm has moved meanwhile.
    declared: (arm,) what its dimensions measure, "" where nobody said.
    """

    gripper: list[int]
    sign: float
    arm: list[int]
    opens: float
    still: float
    shut: float
    middle: float
    moves: NDArray[np.float64]
    rests: NDArray[np.float64]
    window: int
    held: int
    carries: bool
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
        openings = [_openings(state, gripper, 1.0) for state in states]
        change, rest = measure([own[:, None] for own in openings], subset(declared, gripper) or ("",), fps, window)
        low, high = np.quantile(np.concatenate(openings), ENDS).tolist()
        opens, still = max(float(change[0]), OPENS_OF_RANGE * (high - low)), float(rest[0])
        closes_high = config.gripper_closes == "high" or (
            config.gripper_closes is None and _closes_high(openings, (low, high), opens, still, window)
        )
        own = subset(declared, arm)
        moves, rests = measure([state[:, arm] for state in states], own, fps, window)
        reader = cls(
            gripper=gripper,
            sign=-1.0 if closes_high else 1.0,
            arm=arm,
            opens=opens,
            still=still,
            shut=-high if closes_high else low,
            middle=(low + high) / (-2 if closes_high else 2),
            moves=moves,
            rests=rests,
            window=window,
            held=max(1, round(HELD_SECONDS * fps)),
            carries=bool(np.isfinite(moves).any()),
            declared=own,
        )
        every = replace(reader, carries=False)
        count = every.openings(states)
        return every if count >= FEW and reader.openings(states) < CARRIES * count else reader

    def openings(self, states: Sequence[Array]) -> int:
        """How many settled moments are openings of the gripper."""
        return sum(grasp.opened is not None for state in states for grasp in self.grasps(state))

    def __call__(self, state: Array) -> tuple[list[int], list[int], list[list[bool]]]:
        """The moments (m), the last observation each holds to, and which of `NAMES` each is (m, 2)."""
        grasps = self.grasps(state)
        opened = {grasp.opened for grasp in grasps}
        moments = [moment for grasp in grasps for moment in grasp.moments()]
        return moments, self.ends(state, moments), [[t in opened, t not in opened] for t in moments]

    def grasps(self, state: Array) -> list[Grasp]:
        """What the gripper did, in order."""
        openings = _openings(state, self.gripper, self.sign)
        closed, arm = self._closed(openings), np.asarray(state[:, self.arm], np.float64)
        resting = self._resting(arm)
        turns = [0, *(np.flatnonzero(np.diff(closed)) + 1).tolist(), len(arm), len(arm)]
        found = []
        for begin, end, closes in zip(turns, turns[1:], turns[2:], strict=False):
            if begin == end or not closed[begin]:
                continue
            narrow = np.flatnonzero(openings[begin:end] <= openings[begin:end].min() + self.still)
            loosens = begin + int(narrow[-1]) if end < len(arm) else end  # the last observation before they open
            stops = list(self._stops(arm, resting, begin, loosens))
            came_from, opened = (stops or [begin])[-1], None
            moved = not self.carries or self._moved(arm[came_from : loosens + 1])[-1]
            if end < len(arm) and loosens - begin >= self.held and moved:
                wide = openings[end:closes]
                opened = end + int((wide >= wide.max() - self.opens).argmax())
            holds = bool(np.median(openings[begin : max(loosens, begin + 1)]) > self.shut + self.opens)
            found.append(Grasp(begin, loosens, holds, tuple(stops), opened))
        return found

    def closings(self, state: Array) -> NDArray[np.int64]:
        """(k,) the observations of (T+1, S) at which the gripper has closed, the first one left out."""
        closed = self._closed(_openings(state, self.gripper, self.sign))
        return np.flatnonzero(closed[1:] & ~closed[:-1]) + 1

    def ends(self, state: Array, moments: Sequence[int]) -> list[int]:
        """The last observation of each moment's configuration: until the next at the latest."""
        closed = self._closed(_openings(state, self.gripper, self.sign))
        arm = np.asarray(state[:, self.arm], np.float64)
        return [min(self._end(arm, closed, t), other - 1) for t, other in pairwise([*moments, len(arm)])]

    def _resting(self, arm: Array) -> NDArray[np.bool_]:
        """(T+1,) whether the arm stayed within `rests` over the last `window` steps."""
        resting = np.zeros(len(arm), np.bool_)
        if len(arm) > self.window:
            resting[self.window :] = (ranges(continuous(arm, self.declared), self.window) < self.rests).all(axis=1)
        return resting

    def _stops(self, arm: Array, resting: NDArray[np.bool_], begin: int, end: int) -> Iterator[int]:
        """Where the arm comes to rest within (begin, end), having moved since `begin` or since its last stop."""
        while (ready := resting[begin:end] & self._moved(arm[begin:end])).any():
            begin += int(ready.argmax())
            yield begin

    def _moved(self, arm: Array) -> NDArray[np.bool_]:
        """(n,) whether the arm has been away from the first of these positions (n, arm)."""
        away = np.asarray((self._distance(arm, arm[:1]) > self.moves).any(axis=1))
        return np.asarray(np.logical_or.accumulate(away))

    def _closed(self, openings: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(T+1,) whether the gripper is closed: once it closed by `opens` from its widest, until it opens as much."""
        closed, furthest, states = openings[0] <= self.middle, openings[0], []
        for opening in openings.tolist():
            furthest = min(furthest, opening) if closed else max(furthest, opening)
            if abs(opening - furthest) > self.opens:
                closed, furthest = not closed, opening
            states.append(closed)
        return np.array(states, np.bool_)

    def _end(self, arm: Array, closed: NDArray[np.bool_], t: int) -> int:
        """The last observation of t's configuration: until a closed gripper moves, or closes after it was open."""
        away = (self._distance(arm[t:], arm[t]) > self.rests).any(axis=1)
        leaves = closed[t:] & (away | np.logical_or.accumulate(~closed[t:]))
        return t + int(leaves.argmax()) - 1 if leaves.any() else len(arm) - 1

    def _distance(self, one: Array, other: Array) -> Array:
        return np.asarray(np.abs(difference(one, other, self.declared)))


def _matching(names: Sequence[str], patterns: Sequence[str]) -> list[int]:
    """The dimensions whose name matches one of the patterns, upper case like lower."""
    lower = [pattern.lower() for pattern in patterns]
    return [k for k, name in enumerate(names) if any(fnmatchcase(name.lower(), pattern) for pattern in lower)]


def _openings(state: Array, gripper: Sequence[int], sign: float) -> NDArray[np.float64]:
    """(T+1,) how far the gripper is open; 0 throughout where there is none."""
    return sign * np.asarray(state[:, gripper[0]], np.float64) if gripper else np.zeros(len(state))


def _closes_high(
    openings: Sequence[NDArray[np.float64]], ends: tuple[float, float], opens: float, still: float, window: int
) -> bool:
    """Whether a gripper closes at high numbers: objects stop it on its way there, never on its way to open.

    So where it rests between its two ends, it came from where it is open, and goes back there. It closes high if most
    of such rests were come to from below and left to below.
    """
    low, high = ends[0] + opens, ends[1] - opens
    below = above = 0
    for own in openings:
        if len(own) <= window:
            continue
        rests = ranges(own[:, None], window)[:, 0] <= still
        side = np.select([own < low, own > high], [-1, 1], 0)  # at which end the gripper is, or between them
        turns = np.flatnonzero(np.diff(side)) + 1
        for begin, end in pairwise(turns.tolist()):
            if side[begin] == 0 and side[begin - 1] == side[end] and rests[begin : max(begin, end - window)].any():
                below, above = below + (side[end] < 0), above + (side[end] > 0)
    return below > CLEAR * (below + above)
