"""What relabeling reads of a store: lengths, and the settled moments, from `achieved` (or robot and images) alone.

One episode of T actions, in which the achieved goal A changes to B and to C:

    observation   0    1    2    3    4    5    6    7    8    9   10   11=T
    action          0    1    2    3    4    5    6    7    8    9   10
    achieved      AAAAAAAA ~~~~~~~~~~ BBBBBBBBBBBBBB ~~~~~~~~~ CCCCCCCCCC
    settled                           m=5                       m=9
    lasts until         2                       7                     11
    following(t)    5    5    5    5    5    9    9    9    9    -    -      t = 0 ... T-1

A settled moment m is the first at which `achieved` differs from the configuration before it by more than `change` in
some dimension, and has moved less than `rest` in every dimension for `rest_seconds`. Its configuration lasts over
[m, end], until the next change begins. A goal index g of a moment t lies in
(t, T]: at least one action leads to it, and it never leaves its episode.

Flat numbering: step t of episode e is `starts[e] + t` (0 <= t < T_e), observation o of episode e is
row `rows[e] + o` (0 <= o <= T_e), and the settled moments of all episodes stand one after another.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import IMAGES, STORED, Array
from playlearn.layout import ObjectLayout
from playlearn.quantity import Quantities, continuous, difference, subset
from playlearn.relabeling.calibrate import ranges
from playlearn.relabeling.images import NAMES as IMAGE_NAMES
from playlearn.relabeling.images import ImageReader
from playlearn.relabeling.robot import NAMES, RobotReader
from playlearn.relabeling.settling import SettlingConfig, thresholds

Indices = NDArray[np.int64]
STATE, ACHIEVED = STORED["state"], STORED["achieved"]
NONE = np.zeros(0)
Moments = tuple[Sequence[int], Sequence[int], Sequence[Sequence[bool]]]  # moments (m), ends (m), changed (m, G)


class Spec(Protocol):
    """What the index reads of a store's spec."""

    @property
    def achieved_names(self) -> tuple[str, ...]: ...
    @property
    def state_names(self) -> tuple[str, ...]: ...
    @property
    def quantities(self) -> Quantities: ...
    @property
    def fps(self) -> float: ...


class Recordings(Protocol):
    """What the index reads of a store."""

    @property
    def spec(self) -> Spec: ...
    def __len__(self) -> int: ...
    def array(self, i: int, key: str) -> Array: ...
    def cameras(self) -> Mapping[str, tuple[int, int]]: ...


@dataclass(frozen=True, eq=False)
class RelabelIndex:
    """N episodes, M settled moments in all, G achieved dimensions.

    fps: steps a second.
    names: (G,) the dimensions of `changed`.
    declared: (G,) what each of them measures, "" where nobody said.
    lengths: (N,) T of each episode.
    starts: (N+1,) flat numbering of steps, see the drawing.
    rows: (N+1,) flat numbering of observations.
    offsets: (N+1,) episode e has the settled moments offsets[e] ... offsets[e+1]-1.
    moments: (M,) the observation at which each is settled.
    ends: (M,) the last observation of its configuration.
    changed: (M, G) bool, the dimensions that differ from the configuration before it.
    change: (G,) how far each dimension moves before it has changed; empty where moments are read from the robot.
    next_moment: (sum T,) the first settled moment (flat) later than each step; offsets[e+1] where there is none.
    """

    fps: float
    names: tuple[str, ...]
    declared: tuple[str, ...]
    lengths: Indices
    starts: Indices
    rows: Indices
    offsets: Indices
    moments: Indices
    ends: Indices
    changed: NDArray[np.bool_]
    change: NDArray[np.float64]
    next_moment: Indices

    @classmethod
    def build(
        cls,
        achieved: Sequence[Array],
        names: Sequence[str],
        fps: float,
        settling: SettlingConfig,
        declared: Sequence[str] = (),
    ) -> Self:
        """Read the settled moments of each episode's achieved (T+1, G); thresholds of null are measured on it.

        names: (G,).
        declared: (G,) what each dimension measures; () where nobody said.

        Raises:
            UsageError: a threshold is missing or not positive.
        """
        declared = tuple(declared) or ("",) * len(names)
        settling = settling.measured(achieved, names, declared, fps)
        change, rest = (
            thresholds(own, names, declared, what)
            for what, own in (("change", settling.change), ("rest", settling.rest))
        )
        window = settling.window(fps)
        found = [_settled(np.asarray(rows), declared, change, rest, window) for rows in achieved]
        return cls._of([len(rows) - 1 for rows in achieved], found, names, declared, fps, change)

    @classmethod
    def of_store(
        cls,
        store: Recordings,
        settling: SettlingConfig,
        goal_names: Sequence[str] = ("*",),
        episodes: Sequence[int] | None = None,
        learned: Sequence[int] | None = None,
    ) -> Self:
        """The index of a store's episodes, numbered by their place in `episodes` (None: all of them).

        goal_names: patterns of the achieved dimensions in which to look for change and rest; where they choose none,
            moments are read from the robot, and from the images where the source says so.
        learned: the episodes on which thresholds of null are measured (None: all).

        Raises:
            UsageError: a threshold is missing or not positive, a pattern matches nothing, a camera is not named or
                not there.
        """
        spec, every = store.spec, range(len(store))
        episodes, learned = every if episodes is None else episodes, learned or every

        def rows(of: Sequence[int], key: str) -> Iterator[Array]:
            return (store.array(int(i), key) for i in of)

        chosen = ObjectLayout(spec.achieved_names).select(goal_names)
        if settling.source != "achieved" or not chosen:
            reader = robot_reader(store, settling, learned)
            states = list(rows(episodes, STATE))
            lengths = [len(state) - 1 for state in states]
            if settling.source != "images":
                return cls._of(lengths, [reader(state) for state in states], NAMES, ("", ""), spec.fps, NONE)
            cameras, seeing = settling.images.chosen(tuple(store.cameras())), ImageReader(reader, spec.fps)
            seen = [
                seeing(state, [store.array(int(i), IMAGES + camera) for camera in cameras])
                for i, state in zip(episodes, states, strict=True)
            ]
            return cls._of(lengths, seen, IMAGE_NAMES, ("",) * len(IMAGE_NAMES), spec.fps, NONE)
        names = [spec.achieved_names[k] for k in chosen]
        declared = subset(spec.quantities.of("achieved", len(spec.achieved_names)), chosen)
        settling = settling.measured((one[:, chosen] for one in rows(learned, ACHIEVED)), names, declared, spec.fps)
        return cls.build([one[:, chosen] for one in rows(episodes, ACHIEVED)], names, spec.fps, settling, declared)

    @classmethod
    def _of(
        cls,
        steps: Sequence[int],
        found: Sequence[Moments],
        names: Sequence[str],
        declared: Sequence[str],
        fps: float,
        change: NDArray[np.float64],
    ) -> Self:
        """steps: T of each episode."""
        lengths = np.array(steps, np.int64)
        offsets = _running(np.array([len(moments) for moments, _, _ in found], np.int64))
        after = [
            offset + np.searchsorted(moments, np.arange(length), side="right")
            for (moments, _, _), offset, length in zip(found, offsets[:-1], lengths, strict=True)
        ]
        return cls(
            fps=fps,
            names=tuple(names),
            declared=tuple(declared),
            lengths=lengths,
            starts=_running(lengths),
            rows=_running(lengths + 1),
            offsets=offsets,
            moments=np.array([moment for moments, _, _ in found for moment in moments], np.int64),
            ends=np.array([end for _, ends, _ in found for end in ends], np.int64),
            changed=np.array([row for _, _, rows in found for row in rows], np.bool_).reshape(-1, len(names)),
            change=change,
            next_moment=np.concatenate([np.zeros(0, np.int64), *after]).astype(np.int64),
        )

    def following(self, episodes: Indices, t: Indices) -> Indices:
        """(n,) the first settled moment (flat) later than t; `offsets[episodes + 1]` where none is."""
        following: Indices = self.next_moment[self.starts[episodes] + t]
        return following

    def valid(self, episode: int) -> NDArray[np.bool_]:
        """(T,) whether some settled moment of this episode is later than t."""
        valid: NDArray[np.bool_] = self._next(episode) < self.offsets[episode + 1]
        return valid

    def settled(self, episode: int) -> tuple[Indices, Indices]:
        """(m,), (m,): the settled moments of one episode, and the last observation of its configuration."""
        own = slice(self.offsets[episode], self.offsets[episode + 1])
        return self.moments[own], self.ends[own]

    def changes(self, episode: int) -> NDArray[np.bool_]:
        """(T, G) what differs between the settled configurations before and after t; all False past the last."""
        padded = np.concatenate([self.changed, np.zeros((1, len(self.names)), np.bool_)])
        changes: NDArray[np.bool_] = padded[np.where(self.valid(episode), self._next(episode), -1)]
        return changes

    def groups(self) -> tuple[str, ...]:
        """The objects that the dimensions belong to, in order."""
        return tuple(ObjectLayout(self.names).objects())

    def changed_groups(self) -> NDArray[np.bool_]:
        """(M, groups) which object changed at each settled moment."""
        return self._by_group(self.changed)

    def groups_apart(self, one: Array, other: Array) -> NDArray[np.bool_]:
        """(n, groups) in which objects two sets of achieved goals (n, G) differ by more than `change`."""
        return self._by_group(np.abs(difference(one, other, self.declared)) > self.change)

    def change_counts(self) -> dict[str, int]:
        """How often each object changed."""
        return dict(zip(self.groups(), self.changed_groups().sum(axis=0).tolist(), strict=True))

    def _by_group(self, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n, G) -> (n, groups): whether any dimension of an object has its flag set."""
        columns = [flags[:, own].any(axis=1) for own in ObjectLayout(self.names).objects().values()]
        return np.stack(columns, axis=1) if columns else np.zeros((len(flags), 0), np.bool_)

    def _next(self, episode: int) -> Indices:
        return self.next_moment[self.starts[episode] : self.starts[episode + 1]]


def robot_reader(store: Recordings, settling: SettlingConfig, learned: Sequence[int]) -> RobotReader:
    """What reads gripper and arm, with thresholds measured on the given episodes."""
    spec = store.spec
    declared = spec.quantities.of("state", len(spec.state_names))
    states = [store.array(int(i), STATE) for i in learned]
    return RobotReader.measured(states, spec.state_names, declared, spec.fps, settling.robot)


def _settled(achieved: Array, declared: Sequence[str], change: Array, rest: Array, window: int) -> Moments:
    """The settled moments, their ends and what changed of one episode's (T+1, G)."""

    def apart(one: Array, other: Array) -> Array:
        return np.asarray(np.abs(difference(one, other, declared)))

    resting = _resting(continuous(achieved, declared), rest, window)
    moments: list[int] = []
    ends: list[int] = []
    changed: list[list[bool]] = []
    before, at = achieved[0], 0
    while True:
        differs = apart(achieved[at:], before) > change  # (rest of the episode, G)
        ready = resting[at:] & differs.any(axis=1)
        if not ready.any():
            break
        at += int(ready.argmax())
        leaves = (apart(achieved[at:], achieved[at]) > rest).any(axis=1)
        moments.append(at)
        ends.append(at + int(leaves.argmax()) - 1 if leaves.any() else len(achieved) - 1)
        changed.append((apart(achieved[at], before) > change).tolist())
        before = achieved[at]
    return moments, ends, changed


def _resting(achieved: Array, rest: Array, window: int) -> NDArray[np.bool_]:
    """(T+1,) whether every dimension stayed within `rest` over the last `window` steps."""
    resting = np.zeros(len(achieved), np.bool_)
    if len(achieved) > window:
        resting[window:] = (ranges(achieved, window) < rest).all(axis=1)
    return resting


def _running(counts: Indices) -> Indices:
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)]).astype(np.int64)
