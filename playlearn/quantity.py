"""What the dimensions of a vector measure, as whoever recorded them declares it; never read off their names.

A declaration is one text a dimension, `<kind> <group>`: "length x", "quaternion peg". Dimensions of one kind and group
compare: they share mean, spread and thresholds. A dimension that nobody declares, "", stands by itself.

kind         numbers                                    two of them differ by
length       meters                                     their difference
direction    cosine, sine, entry of a rotation matrix   their difference
angle        radians, where a whole turn is no turn     the shorter way round, -pi to pi
quaternion   the four of one orientation, a group       the nearer of q and -q, which are one orientation
binary       0 or 1                                     their difference: changed where it passes a half
plain        of a unit of their own (rad of a joint)    their difference
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Bounds = tuple[tuple[float, float] | None, ...]  # lowest and highest of each dimension; () where nobody said
KINDS = ("length", "direction", "angle", "quaternion", "binary", "plain")
TURN = 2 * np.pi
FINEST = 1e-4  # SI units: a declared dimension that stays within so small a range has not moved
ROUNDING = 1e-6  # of its size: a float32 that does not vary is uncertain by a tenth of this

# What the names of playlearn's own environments end in, and OGBench's and robosuite's recordings as they are imported.
_OWN = {
    **dict.fromkeys(("x", "y", "z", "opening", "position"), "length"),
    **dict.fromkeys(("c", "s", "r00", "r10", "r20", "r01", "r11", "r21"), "direction"),
    **dict.fromkeys(("on",), "binary"),
}
_QUATERNION = ("qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Quantities:
    """What the numbers of an environment or a recording measure; () where nobody said.

    state: (S,) the declaration of each dimension of `state`, see the module.
    achieved: (G,) of each dimension of `achieved`.
    action_bounds: (A,) the lowest and the highest value of each action; None where it has none.
    """

    state: tuple[str, ...] = ()
    achieved: tuple[str, ...] = ()
    action_bounds: Bounds = ()

    def of(self, name: str, width: int) -> tuple[str, ...]:
        """(width,) the declarations of `state` or `achieved`; "" throughout where nobody said."""
        given: tuple[str, ...] = getattr(self, name, ())
        return given or ("",) * width

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> Self:
        """What `dataclasses.asdict` made of one and JSON gave back."""
        bounds = tuple(None if pair is None else (float(pair[0]), float(pair[1])) for pair in written["action_bounds"])
        return cls(tuple(written["state"]), tuple(written["achieved"]), bounds)


def own_quantities(state: Sequence[str], achieved: Sequence[str], actions: int) -> Quantities:
    """Of an environment of playlearn's own: names end in what is measured, actions lie in [-1, 1].

    state: names.
    achieved: names.
    actions: A.
    """
    return Quantities(tuple(map(_own, state)), tuple(map(_own, achieved)), ((-1.0, 1.0),) * actions)


def _own(name: str) -> str:
    owner, _, part = name.rpartition(".")
    if part in _QUATERNION:
        return f"quaternion {owner}"
    return f"{_OWN.get(part, 'plain')} {part}"


def kind(declared: str) -> str:
    """The kind of a dimension; "" where nobody said."""
    return declared.partition(" ")[0]


def pools(declared: Sequence[str]) -> list[list[int]]:
    """The dimensions that compare, by pool; every dimension is in one, by itself where nothing compares with it."""
    alone = ("", "quaternion")  # of an orientation, no part compares with another
    return list(_by_text([f"{text} {k}" if kind(text) in alone else text for k, text in enumerate(declared)]).values())


def within(values: Array, bounds: Bounds) -> Array:
    """(..., D) clipped to their bounds, where they have any."""
    if not bounds:
        return values
    low, high = zip(*(pair or (-np.inf, np.inf) for pair in bounds), strict=True)
    clipped: Array = np.clip(values, np.array(low, values.dtype), np.array(high, values.dtype))
    return clipped


def subset(declared: Sequence[str], columns: Sequence[int]) -> tuple[str, ...]:
    """The declarations of some dimensions; () stays ()."""
    return tuple(declared[k] for k in columns) if declared else ()


def spellings(declared: Sequence[str]) -> tuple[list[int], list[list[int]]]:
    """The dimensions that have more than one spelling: the angles, and the parts of each quaternion."""
    quaternions = [own for text, own in _by_text(declared).items() if kind(text) == "quaternion"]
    return [k for k, text in enumerate(declared) if kind(text) == "angle"], quaternions


def nearest(value: Array, reference: Array, declared: Sequence[str]) -> Array:
    """(..., D): value in the spelling that is nearest to the reference; shapes broadcast."""
    angles, quaternions = spellings(declared)
    if not angles and not quaternions:
        return value
    spelled = np.array(np.broadcast_to(value, np.broadcast_shapes(value.shape, reference.shape)))
    off = spelled[..., angles] - reference[..., angles]
    spelled[..., angles] -= (TURN * np.round(off / TURN)).astype(spelled.dtype)
    for own in quaternions:
        apart = (spelled[..., own] * reference[..., own]).sum(axis=-1, keepdims=True) < 0
        spelled[..., own] *= np.where(apart, -1, 1).astype(spelled.dtype)
    return spelled


def difference(one: Array, other: Array, declared: Sequence[str]) -> Array:
    """(..., D): one less other, each dimension as its kind has it; shapes broadcast."""
    off: Array = one - nearest(other, one, declared)
    return off


def continuous(rows: Array, declared: Sequence[str]) -> Array:
    """(T, D): the same with no jump from one spelling to another between consecutive rows."""
    angles, quaternions = spellings(declared)
    if not angles and not quaternions:
        return rows
    spelled = np.array(rows)
    spelled[:, angles] = np.unwrap(rows[:, angles], axis=0)
    for own in quaternions:
        apart = (rows[1:, own] * rows[:-1, own]).sum(axis=1) < 0
        spelled[1:, own] *= np.cumprod(np.where(apart, -1, 1))[:, None].astype(spelled.dtype)
    return spelled


def middle(rows: Array, declared: Sequence[str]) -> NDArray[np.float64]:
    """(D,) a reference to spell rows (n, D) by: of angles the mean direction, of a quaternion the mean orientation."""
    angles, quaternions = spellings(declared)
    reference = np.zeros(rows.shape[1])
    own = np.asarray(rows[:, angles], np.float64)
    reference[angles] = np.arctan2(np.sin(own).mean(axis=0), np.cos(own).mean(axis=0))
    for quaternion in quaternions:
        parts = np.asarray(rows[:, quaternion], np.float64)
        axis = np.linalg.eigh(parts.T @ parts)[1][:, -1]  # the same whichever of q and -q is recorded
        reference[quaternion] = axis * np.sign(axis[np.abs(axis).argmax()])
    return reference


def _by_text(declared: Sequence[str]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for k, text in enumerate(declared):
        found.setdefault(text, []).append(k)
    return found
