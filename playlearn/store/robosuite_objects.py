"""The order of the numbers in robosuite's `object-state`, robomimic's `object`, task by task (Zhu et al., 2020).

robosuite observes each object by where it is and by where it is relative to the gripper. The order of the two, and of
what else there is, changed with robosuite 1.5. Where a file does not say which robosuite it is from, its own numbers
do: the distance of an object from the gripper is that of their places.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from playlearn.episode import Array
from playlearn.store.hand import moves_with_hand

OLD, NEW = "up to 1.4", "1.5"
MOST = 0.5  # of the rows, in which a distance must agree: robosuite 1.5 takes the place of one step before
CLOSE = 0.005  # meters
_PARTS = {"p": ("x", "y", "z"), "q": ("qx", "qy", "qz", "qw"), "": ("",)}
_RELATIVE = re.compile(r"gripper\d?_to_(?P<first>\w+)|(?P<last>\w+)_to_eef")

# name:p is a place, name:q an orientation, any other a single number. `*` marks what is relative to a gripper or held
# by one, `~` what follows from the others.
_LIFT = "cube:p cube:q gripper_to_cube:p*"
_CUBES = "cubeA:p cubeA:q cubeB:p cubeB:q"
_TO_CUBES, _BETWEEN = "gripper_to_cubeA:p* gripper_to_cubeB:p*", "cubeA_to_cubeB:p~"
_DOOR, _TO_DOOR, _HINGE, _LATCH = "door:p handle:p", "door_to_eef:p* handle_to_eef:p*", "door.hinge", "handle.angle"
_BINS = "payload:p payload:q trash:p trash:q lid_handle:p lid_handle:q target_bin:p trash_bin:p"
_DELIVERED = "payload.in_target_bin trash.in_trash_bin"
_TO_BINS = "gripper0_to_payload:p* gripper0_to_lid_handle:p* gripper1_to_payload:p* gripper1_to_trash:p*"
_POT = "pot:p pot:q handle0:p handle1:p gripper0_to_handle0:p* gripper1_to_handle1:p*"
_HAMMER = "hammer:p hammer:q handle:p gripper0_to_handle:p* gripper1_to_handle:p*"
_PEG = "hole:p* hole:q* peg_to_hole:p* peg:q* peg_to_hole.angle* peg_to_hole.parallel* peg_to_hole.perpendicular*"
_WIPE = "wipe.proportion wipe.radius wipe:p"


def _each(objects: str, order: str, rest: str = "") -> str:
    """The pose of each object, absolute and relative."""
    own, relative = "{0}:p {0}:q", "{0}_to_eef:p* {0}_to_eef:q*"
    pattern = f"{own} {relative}" if order == OLD else f"{relative} {own}"
    return " ".join([*(pattern.format(name) for name in objects.split()), rest])


def _posed(objects: str, rest: str = "") -> dict[str, str]:
    return {order: _each(objects, order, rest) for order in (OLD, NEW)}


def _both(text: str) -> dict[str, str]:
    """The same in every version."""
    return {f"{OLD} and {NEW}": text}


def _markers(relative: bool, width: int) -> dict[str, str]:
    one = "marker{0}:p marker{0}.wiped" + (" gripper_to_marker{0}:p*" if relative else "")
    count = width // (7 if relative else 4)
    return _both(" ".join(one.format(k) for k in range(count)))


def _orders(task: str, width: int) -> list[dict[str, str]]:
    """What is known of a task, whatever its width: order of which version -> its text."""
    one_object = {f"PickPlace{name}": name for name in ("Milk", "Bread", "Cereal", "Can")}
    one_object |= {"NutAssemblySquare": "SquareNut", "NutAssemblyRound": "RoundNut"}
    if task in one_object:
        return [_posed(one_object[task])]
    known: dict[str, list[dict[str, str]]] = {
        "Lift": [_both(_LIFT)],
        "Stack": [{OLD: f"{_CUBES} {_TO_CUBES} {_BETWEEN}", NEW: f"{_CUBES} {_BETWEEN} {_TO_CUBES}"}],
        "PickPlace": [_posed("Milk Bread Cereal Can")],
        "PickPlaceSingle": [_posed("object", "object_id")],
        "NutAssembly": [_posed("SquareNut RoundNut")],
        "NutAssemblySingle": [_posed("nut", "nut_id")],
        "Door": [
            {OLD: f"{_DOOR} {_TO_DOOR} {_HINGE} {latch}", NEW: f"{_DOOR} {_HINGE} {_TO_DOOR} {latch}"}
            for latch in ("", _LATCH)
        ],
        "Wipe": [
            _both(_WIPE),
            _both(f"{_WIPE} gripper_to_wipe:p*"),
            *(
                _markers(relative, width) for relative in (True, False) if width > 8
            ),  # 100 markers, if not told otherwise
        ],
        "ToolHang": [_posed("base frame tool", "frame.assembled tool.on_frame")],
        "TwoArmTransport": [
            {OLD: f"{_BINS} {_TO_BINS} {_DELIVERED}", NEW: f"{_BINS} {_DELIVERED} {_TO_BINS}"},
        ],
        "TwoArmLift": [_both(_POT)],
        "TwoArmHandover": [_both(_HAMMER)],
        "TwoArmPegInHole": [_both(_PEG)],
    }
    return known.get(task, [])


@dataclass(frozen=True)
class ObjectOrder:
    """What stands where.

    versions: of robosuite that have this order.
    text: see the table.
    """

    versions: str
    text: str

    @cached_property
    def _runs(self) -> list[tuple[str, str, str, slice]]:
        """Name, kind ("p", "q" or ""), mark ("*", "~" or "") and place of each entry."""
        runs, at = [], 0
        for entry in self.text.split():
            bare = entry.rstrip("*~")
            name, _, kind = bare.partition(":")
            runs.append((name, kind, entry[len(bare) :], slice(at, at + len(_PARTS[kind]))))
            at += len(_PARTS[kind])
        return runs

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(G,) name of each dimension: `cube.x`."""
        return tuple(f"{name}.{part}" if part else name for name, kind, *_ in self._runs for part in _PARTS[kind])

    def marked(self, mark: str) -> tuple[bool, ...]:
        """(G,) the dimensions that are relative to a gripper (`*`), or follow from others (`~`)."""
        return tuple(own == mark for _, kind, own, _ in self._runs for _ in _PARTS[kind])

    def agrees(self, rows: Array, hands: Sequence[Array]) -> bool:
        """Whether each object in rows (n, G) is as far from a gripper (n, 3) as its relative place says, and moves."""
        place = {name: rows[:, at] for name, kind, mark, at in self._runs if kind == "p" and not mark}
        found = []
        for name, kind, mark, at in self._runs:
            match = _RELATIVE.fullmatch(name)
            if kind == "p" and mark == "*" and match:
                own = place[match["first"] or match["last"]]
                stated = np.linalg.norm(rows[:, at], axis=1)
                apart = [np.abs(np.linalg.norm(own - hand, axis=1) - stated) < CLOSE for hand in hands]
                found.append(any(close.mean() >= MOST for close in apart))
        return bool(found) and all(found)


def known_order(
    task: str, version: str, objects: Sequence[Array], robot: Sequence[Array], hands: Sequence[Array]
) -> ObjectOrder | None:
    """The order of the numbers of a file; None where it cannot be told.

    task: name of robosuite's environment; MimicGen's variants of them (`Stack_D0`) are of the same order.
    version: robosuite's, "" where the file does not say.
    objects, robot: an (n, G) and an (n, S) an episode.
    hands: (m, 3) the place of each hand, in all episodes one after another; none where it is not recorded.
    """
    every = np.concatenate(objects)
    orders = object_orders(task, every.shape[1])
    consistent = [one for one in orders if one.agrees(every, hands)]
    if consistent or not orders:
        return consistent[0] if len(consistent) == 1 else None
    # No distances to compare: an order is possible unless what it takes for objects moves with the hand.
    with_hand = moves_with_hand(objects, robot)
    possible = [one for one in orders if not (with_hand & ~np.array(one.marked("*"))).any()]
    if len(possible) > 1:
        possible = [one for one in possible if one in object_orders(task, every.shape[1], version)]
    return possible[0] if len(possible) == 1 else None


def object_orders(task: str, width: int, version: str = "") -> list[ObjectOrder]:
    """The orders of a task's numbers that are known and of this width; those of one version if it is given."""
    plain = re.sub(r"_[DO]\d$", "", task)
    plain = {"Square": "NutAssemblySquare"}.get(plain, plain)
    orders = {ObjectOrder(versions, text) for known in _orders(plain, width) for versions, text in known.items()}
    fitting = sorted((one for one in orders if len(one.names) == width), key=lambda one: one.versions)
    numbers = re.match(r"(\d+)\.(\d+)", version)
    if numbers is None:
        return fitting
    own = NEW if (int(numbers[1]), int(numbers[2])) >= (1, 5) else OLD
    return [one for one in fitting if own in one.versions]
