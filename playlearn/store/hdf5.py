"""HDF5 as robosuite and robomimic lay it out, a group a demonstration, `data/demo_12`; what is not plain is refused."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import nearest
from playlearn.episode import Array, Episode
from playlearn.errors import EpisodeError, StoreError, UsageError

_DEMO = re.compile(r"demo_(\d+)")


def library() -> Any:
    """h5py. Raises UsageError where it is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise UsageError("HDF5 needs the extra `robomimic`: pip install 'playlearn[robomimic]'") from error
    return h5py


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The file's group `data` belongs to, open for reading.

    Raises:
        UsageError: h5py is not installed.
        StoreError: there is no such file, or it cannot be read as HDF5.
    """
    h5py = library()
    if not path.is_file():
        raise StoreError(f"there is no file {path}")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise StoreError(f"{path} is no HDF5 file, or not a whole one ({error}): fetch it again") from error
    with file:
        yield file


def demonstrations(file: Any, path: Path) -> dict[int, str]:
    """Number -> name of its group, in numeric order: demo_2 comes before demo_10.

    Raises:
        StoreError: there are none.
    """
    import h5py

    data = file.get("data")
    if not isinstance(data, h5py.Group):
        raise StoreError(f"{path} has no group `data`: it is neither robomimic's nor robosuite's")
    found = {int(match[1]): name for name in data if (match := _DEMO.fullmatch(name))}
    if not found:
        raise StoreError(f"{path} holds no demonstration (no `data/demo_0` or the like)")
    return dict(sorted(found.items()))


def masks(file: Any, path: Path, names: Mapping[int, str]) -> dict[str, list[int]]:
    """Mask -> the numbers of its demonstrations, in numeric order. Raises StoreError where one is not there."""
    numbers = {name: number for number, name in names.items()}
    found = {}
    for mask in file.get("mask", ()):
        members = [name.decode() if isinstance(name, bytes) else str(name) for name in plain_array(file["mask"], mask)]
        missing = sorted(set(members) - numbers.keys())
        if missing:
            raise StoreError(f"{path}: mask {mask!r} names {missing[0]}, and there is no such demonstration")
        found[mask] = sorted(numbers[name] for name in members)
    return found


def chosen(mask: str | None, known: Mapping[str, Sequence[int]], path: Path) -> list[int] | None:
    """The numbers under a mask, None for all. Raises UsageError where there is no such mask."""
    if mask is None:
        return None
    if mask not in known:
        raise UsageError(f"{path} has no mask {mask!r}{nearest(mask, list(known)) or '; it has none at all'}")
    return list(known[mask])


def dataset(group: Any, key: str) -> Any:
    """A dataset of numbers or text that lies in this very file.

    Raises:
        StoreError: it is missing, lies elsewhere (a link), or holds objects.
    """
    import h5py

    where = f"{group.file.filename}: {group.name}/{key}"
    place = group
    for part in key.split("/"):
        link = place.get(part, getlink=True) if isinstance(place, h5py.Group) and part in place else None
        if not isinstance(link, h5py.HardLink):
            raise StoreError(f"{where} is {'missing' if link is None else 'a link, which is not followed'}")
        place = place[part]
    if not isinstance(place, h5py.Dataset):
        raise StoreError(f"{where} is a group, not an array")
    if place.is_virtual or place.external:
        raise StoreError(f"{where} has its numbers in another file, which is not read")
    return place


def plain_array(group: Any, key: str) -> Array:
    """All of it, in memory."""
    return np.asarray(dataset(group, key)[()])


def described(group: Any, key: str) -> dict[str, Any]:
    """A JSON attribute, such as `env_args`; {} where there is none. Raises StoreError where it is no JSON."""
    text = group.attrs.get(key)
    if text is None:
        return {}
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError) as error:
        raise StoreError(f"{group.file.filename}: the attribute {key} of {group.name} is not JSON ({error})") from error


class Demonstrations:
    """What files of robomimic and of robosuite have in common as `Recordings`; set up by who knows the format.

    _names, _problems: number of a demonstration -> its name, and what is wrong with it.
    """

    _path: Path
    _names: Mapping[int, str]
    _problems: Mapping[int, str]

    def names(self) -> Mapping[int, str]:
        return self._names

    def problems(self) -> Mapping[int, str]:
        return self._problems

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        with opened(self._path) as file:
            for number in numbers:
                name = f"{self._path}: {self._names[number]}"
                try:
                    yield number, self._episode(file["data"][self._names[number]], number, name)
                except (EpisodeError, OSError) as error:
                    yield number, StoreError(f"{name}: {error}")
                except StoreError as error:
                    yield number, error

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        """One demonstration, called `name` in messages."""
        raise NotImplementedError
