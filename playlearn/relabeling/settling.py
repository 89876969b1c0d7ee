"""When the achieved goal counts as changed and when as at rest: thresholds, given or measured on the play itself."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.quantity import kind
from playlearn.relabeling.calibrate import SWITCHED, measure
from playlearn.relabeling.images import ImagesConfig
from playlearn.relabeling.robot import RobotConfig

Thresholds = dict[str, float | None]


@dataclass(frozen=True)
class SettlingConfig:
    """When the achieved goal counts as changed, and when as at rest.

    change: pattern of achieved names (`*.z`), or kind of what they measure (`kind:length`, see `quantity.py`) -> how
        far a dimension moves before it has changed, in its own unit.
    rest: pattern or kind -> the range within which a dimension stays while at rest.
    rest_seconds: for how long it must stay there.
    source: what settled moments are read from: `achieved`; `robot`, gripper and arm with measured thresholds, which is
        also used wherever `achieved` is empty (recordings of a real robot); or `images`, these and what cameras that
        stand still show of what a shut gripper did.
    robot: which numbers are gripper and arm.
    images: which cameras.

    `default` covers every name that nothing else matches; of several that match, the last one counts. A threshold of
    null is measured on the play (see `calibrate.measure`): `{default: null}` measures all of them.

    The default thresholds of the kinds are for a tabletop in a simulator; a dimension whose unit nobody declared is
    measured. In two stores of play on PlayTable, 91 and 96 % of the
    moments they find lie within 0.2 s of one that measured thresholds find, and the other way round. Under 3 mm of
    noise they find none, while measured ones still find 59 and 70 % of those moments: measure the thresholds where
    `achieved` comes from sensors.
    """

    change: Thresholds = field(default_factory=lambda: _of_kinds(length=0.015, turn=0.15))
    rest: Thresholds = field(default_factory=lambda: _of_kinds(length=0.004, turn=0.05))
    rest_seconds: float = 0.3
    source: Literal["achieved", "robot", "images"] = "achieved"
    robot: RobotConfig = field(default_factory=RobotConfig)
    images: ImagesConfig = field(default_factory=ImagesConfig)

    def window(self, fps: float) -> int:
        """rest_seconds in steps."""
        return max(1, round(self.rest_seconds * fps))

    def measured(self, rows: Iterable[Array], names: Sequence[str], declared: Sequence[str], fps: float) -> Self:
        """The same with each null measured on rows, each (T+1, G), which are not read where nothing is null.

        names: (G,).
        declared: (G,) what each dimension measures, "" where nobody said.
        """
        given = [_given(own, *of, what) for what, own in self._both() for of in zip(names, declared, strict=True)]
        if None not in given:
            return self
        measured = measure(list(rows), declared, fps, self.window(fps))
        change, rest = (
            _filled(own, names, declared, found, what)
            for (what, own), found in zip(self._both(), measured, strict=True)
        )
        return replace(self, change=change, rest=rest)

    def _both(self) -> list[tuple[str, Thresholds]]:
        return [("change", self.change), ("rest", self.rest)]


def thresholds(
    patterns: Mapping[str, float | None], names: Sequence[str], declared: Sequence[str], what: str
) -> NDArray[np.float64]:
    """(G,) the threshold of each name.

    declared: (G,) what each measures, "" where nobody said.

    Raises:
        UsageError: a name has none, or one is not positive.
    """
    values = []
    for name, text in zip(names, declared, strict=True):
        value = _given(patterns, name, text, what)
        if value is None:
            raise UsageError(
                f"settling.{what}: {name} needs a threshold, for nobody declared what it measures: give one, or "
                "declare it where the environment makes its spec (`quantities`)"
            )
        if not value > 0:
            raise UsageError(f"settling.{what}: {name} needs a threshold above 0, got {value}")
        values.append(value)
    return np.array(values, np.float64)


def _of_kinds(length: float, turn: float) -> Thresholds:
    """length: meters; turn: of cosines, sines and radians, half of that of a quaternion, which turns half as far."""
    turns = {"kind:direction": turn, "kind:angle": turn, "kind:quaternion": turn / 2}
    return {"default": None, "kind:length": length, **turns, "kind:binary": SWITCHED, "kind:plain": length}


def _given(patterns: Mapping[str, float | None], name: str, declared: str, what: str) -> float | None:
    own = f"kind:{kind(declared)}"
    fitting = [
        value
        for pattern, value in patterns.items()
        if pattern != "default" and (pattern == own or fnmatchcase(name, pattern))
    ]
    if not fitting and "default" not in patterns:
        raise UsageError(f"settling.{what}: {name} needs a threshold; add one, or `default`")
    return fitting[-1] if fitting else patterns["default"]


def _filled(
    patterns: Thresholds, names: Sequence[str], declared: Sequence[str], measured: Array, what: str
) -> Thresholds:
    """A threshold for each name: the given one, or the measured one where that is null."""
    given = [_given(patterns, name, text, what) for name, text in zip(names, declared, strict=True)]
    filled = [own if value is None else value for value, own in zip(given, measured.tolist(), strict=True)]
    return dict(zip(names, filled, strict=True))
