"""When the achieved goal counts as changed and when as at rest: thresholds, given or measured on the play itself."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.relabeling.calibrate import measure
from playlearn.relabeling.robot import RobotConfig

Thresholds = dict[str, float | None]


@dataclass(frozen=True)
class SettlingConfig:
    """When the achieved goal counts as changed, and when as at rest.

    change: pattern of achieved names -> how far a dimension moves before it has changed (meters; cosine and sine of an
        orientation, `*.c` and `*.s`, in their own unit; lamps 0 or 1).
    rest: pattern -> the range within which a dimension stays while at rest.
    rest_seconds: for how long it must stay there.
    source: what settled moments are read from: `achieved`, or `robot`, gripper and arm with measured thresholds, which
        is also used wherever `achieved` is empty (recordings of a real robot).
    robot: which numbers are gripper and arm.

    The pattern `default` covers every name that no other pattern matches; of several that match, the last one counts. A
    threshold of null is measured on the play (see `calibrate.measure`): `{default: null}` measures all of them.

    The default thresholds are for a tabletop in a simulator. In two stores of play on PlayTable, 91 and 96 % of the
    moments they find lie within 0.2 s of one that measured thresholds find, and the other way round. Under 3 mm of
    noise they find none, while measured ones still find 59 and 70 % of those moments: measure the thresholds where
    `achieved` comes from sensors.
    """

    change: Thresholds = field(default_factory=lambda: {"default": 0.015, "*.c": 0.15, "*.s": 0.15, "*.on": 0.5})
    rest: Thresholds = field(default_factory=lambda: {"default": 0.004, "*.c": 0.05, "*.s": 0.05, "*.on": 0.5})
    rest_seconds: float = 0.3
    source: Literal["achieved", "robot"] = "achieved"
    robot: RobotConfig = field(default_factory=RobotConfig)

    def window(self, fps: float) -> int:
        """rest_seconds in steps."""
        return max(1, round(self.rest_seconds * fps))

    def measured(self, rows: Iterable[Array], names: Sequence[str], fps: float) -> Self:
        """The same with each null measured on rows, each (T+1, G), which are not read where nothing is null."""
        if None not in (*self.change.values(), *self.rest.values()):
            return self
        change, rest = measure(list(rows), names, fps, self.window(fps))
        return replace(
            self, change=_filled(self.change, names, change, "change"), rest=_filled(self.rest, names, rest, "rest")
        )


def thresholds(patterns: Mapping[str, float | None], names: Sequence[str], what: str) -> NDArray[np.float64]:
    """(G,) the threshold of each name.

    Raises:
        UsageError: a name has none, or one is not positive.
    """
    values = []
    for name in names:
        value = _given(patterns, name, what)
        if value is None or not value > 0:
            raise UsageError(f"settling.{what}: {name} needs a threshold above 0, got {value}")
        values.append(value)
    return np.array(values, np.float64)


def _given(patterns: Mapping[str, float | None], name: str, what: str) -> float | None:
    fitting = [value for pattern, value in patterns.items() if pattern != "default" and fnmatchcase(name, pattern)]
    if not fitting and "default" not in patterns:
        raise UsageError(f"settling.{what}: {name} needs a threshold; add one, or `default`")
    return fitting[-1] if fitting else patterns["default"]


def _filled(patterns: Thresholds, names: Sequence[str], measured: Array, what: str) -> Thresholds:
    """A threshold for each name: the given one, or the measured one where that is null."""
    given = [_given(patterns, name, what) for name in names]
    filled = [own if value is None else value for value, own in zip(given, measured.tolist(), strict=True)]
    return dict(zip(names, filled, strict=True))
