"""What the numbers about objects are called, and which of them goals are about: not those that depend on the hand."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.store.hand import moves_with_hand
from playlearn.store.robosuite_objects import ObjectOrder

type Columns = Sequence[tuple[Array, Array]]  # objects (n, G) and robot (n, S) of each episode


@dataclass(frozen=True)
class ObjectDimensions:
    """G numbers.

    names: (G,).
    kept: the dimensions that goals are about.
    remarks: names -> why they are left out.
    """

    names: tuple[str, ...]
    kept: tuple[int, ...]
    remarks: Mapping[str, str] = field(default_factory=dict)

    def goals(self) -> tuple[str, ...]:
        """Names of the dimensions that goals are about."""
        return tuple(self.names[k] for k in self.kept)


def own_dimensions(names: tuple[str, ...], goal_names: Sequence[str] | None) -> ObjectDimensions:
    """Those of play that was recorded here: all are about objects, unless the user names some."""
    return ObjectDimensions(names, tuple(range(len(names)))) if goal_names is None else _asked(names, goal_names)


def choose_dimensions(
    order: ObjectOrder | None,
    names: tuple[str, ...],
    read: Callable[[], Columns],
    goal_names: Sequence[str] | None,
    where: Path,
    without: str,
) -> ObjectDimensions:
    """Those of a file of somebody else.

    order: of a known task; None has what depends on the hand measured.
    names: (G,) where the order is not known.
    read: all episodes.
    goal_names: patterns of the names that goals are about, whatever they depend on.
    without: the setting that leaves goals to the robot, for messages.

    Raises:
        UsageError: a pattern matches nothing; or nothing is left that goals could be about.
    """
    names = order.names if order else names
    if not names:
        return ObjectDimensions((), ())
    if goal_names is not None:
        return _asked(names, goal_names)
    if order:
        with_hand, twice = np.array(order.marked("*")), np.array(order.marked("~"))
        how = f"relative to the hand or held by it, in robosuite's order ({order.versions})"
    else:
        columns = read()
        with_hand = moves_with_hand([objects for objects, _ in columns], [robot for _, robot in columns])
        twice, how = np.zeros(len(names), np.bool_), "measured: changing with the hand while nothing else does"
    remarks = _remark(names, with_hand, f"left out of goals: {how}; --goal_names names what they are about")
    remarks |= _remark(names, twice, "left out of goals: it follows from the objects' places")
    kept = np.flatnonzero(~with_hand & ~twice)
    if not len(kept):
        raise UsageError(
            f"goal_names: {where}: nothing is left that goals could be about, as {', '.join(names)} are {how}. Name "
            f"those that they are about all the same (--goal_names '[\"*\"]'), or leave goals to the robot ({without})"
        )
    return ObjectDimensions(names, tuple(kept.tolist()), remarks)


def _asked(names: tuple[str, ...], goal_names: Sequence[str]) -> ObjectDimensions:
    kept = tuple(ObjectLayout(names).select(goal_names))
    rest = np.array([k not in kept for k in range(len(names))])
    return ObjectDimensions(names, kept, _remark(names, rest, "left out of goals: not in `goal_names`"))


def _remark(names: Sequence[str], marked: Iterable[bool], why: str) -> dict[str, str]:
    """One remark for all the dimensions that are marked."""
    own = [name for name, mark in zip(names, marked, strict=True) if mark]
    return {", ".join(own): why} if own else {}
