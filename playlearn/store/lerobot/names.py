"""The names of a vector's dimensions, from every form of `names` in `info.json` that LeRobot or its datasets have.

    ["x", "y"]   [["x", "y"]]                      in order
    {"motors": ["x", "y"]}   {"axes": ["x", "y"]}  in order, under what they are
    {"left": ["j0"], "right": ["j0"]}              one after another; `left.j0` where the names alone would be equal
    {"y": 1, "x": 0}                               each at its index, as LeRobot's gamepad and keyboard write it
    {"0": "x", "1": "y"}                           the same the other way around

Where it holds anything else, the dimensions of `observation.state` are called `state.0`, `state.1`, ...
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

type Named = tuple[str, str]  # (what it is a part of, as a prefix; its name)


def read_names(key: str, names: Any, size: int) -> tuple[tuple[str, ...], str]:
    """The name of each of a feature's `size` dimensions, all different; and why they are not the recorded ones, or "".

    key: of the feature.
    names: as `info.json` has them.
    """
    numbered = tuple(f"{key.removeprefix('observation.')}.{k}" for k in range(size))
    if not names:
        return numbered, ""
    places = _places(names)
    try:
        named = _in_order(names) if places is None else _placed(places, numbered)
        found = _told_apart(named, size)
    except ValueError as error:
        return numbered, f"its `names` {error}: they are called {_listed(numbered)}"
    if places is not None and len(places) < size:
        return found, f"its `names` are those of {len(places)} of {size} numbers: they are called {_listed(found)}"
    if twice := _twice(named, found):
        return found, f"its `names` have {twice} more than once: they are called {_listed(found)}"
    return found, ""


def _places(names: Any, group: str = "") -> list[tuple[int, Named]] | None:
    """The index of each name where `names` maps one to the other; None where it does not."""
    if not isinstance(names, Mapping):
        return None
    if all(isinstance(value, int) and not isinstance(value, bool) for value in names.values()):
        return [(index, (group, str(name))) for name, index in names.items()]
    if all(str(index).isdecimal() and isinstance(name, str) for index, name in names.items()):
        return [(int(index), (group, name)) for index, name in names.items()]
    parts = [_places(value, f"{group}{part}.") for part, value in names.items()]
    return None if None in parts else [place for part in parts for place in part or ()]


def _placed(places: Sequence[tuple[int, Named]], numbered: Sequence[str]) -> list[Named]:
    """The names at their indices, `numbered` where there is none; raises ValueError where an index is not one."""
    found = dict(places)
    if len(found) < len(places) or not found.keys() <= set(range(len(numbered))):
        raise ValueError(f"are not at {len(places)} of the indices 0 to {len(numbered) - 1}")
    return [found.get(k, ("", other)) for k, other in enumerate(numbered)]


def _in_order(names: Any, group: str = "") -> list[Named]:
    """The names one after another; raises ValueError where there is something else."""
    if isinstance(names, str) and names.strip():
        return [(group, names)]
    if isinstance(names, Mapping):
        if len(names) > 1 and all(isinstance(value, str) for value in names.values()):
            raise ValueError("map texts to texts, and which are the names is not known")
        return [pair for part, value in names.items() for pair in _in_order(value, f"{group}{part}.")]
    if isinstance(names, Sequence) and not isinstance(names, str):
        return [pair for value in names for pair in _in_order(value, group)]
    raise ValueError(f"hold {names!r}, which is no name")


def _told_apart(named: Sequence[Named], size: int) -> tuple[str, ...]:
    """The names, if they differ; else each with what it is a part of, or equal ones with a number.

    Raises:
        ValueError: they are not as many as the dimensions, or equal all the same.
    """
    if len(named) != size:
        raise ValueError(f"are {len(named)} for {size} numbers")
    names = tuple(name for _, name in named)
    number = [names[:k].count(name) for k, name in enumerate(names)]
    numbered = tuple(f"{name}_{n}" if names.count(name) > 1 else name for name, n in zip(names, number, strict=True))
    for found in (names, tuple(group + name for group, name in named), numbered):
        if len(set(found)) == size:
            return found
    raise ValueError("cannot be told apart")


def _twice(named: Sequence[Named], found: Sequence[str]) -> str:
    """The names that more than one dimension has, where they had to be changed."""
    counts = Counter(name for _, name in named)
    changed = [name for (_, name), other in zip(named, found, strict=True) if name != other]
    return ", ".join(repr(name) for name in dict.fromkeys(changed) if counts[name] > 1)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 16 else f"{', '.join(names[:8])}, ..., {names[-1]}"
