"""HDF5 files of robosuite and robomimic: a group for each demonstration, `data/demo_12`; only plain arrays are read."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from playlearn.config import nearest
from playlearn.episode import Array, Episode
from playlearn.errors import EpisodeError, StoreError, UsageError

_DEMO = re.compile(r"demo_(\d+)")


def import_h5py() -> Any:
    """h5py; raises UsageError if it is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise UsageError("HDF5 needs the extra `robomimic`: pip install 'playlearn[robomimic]'") from error
    return h5py


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """The file, open for reading.

    Raises:
        UsageError: h5py is not installed.
        StoreError: there is no such file, or it cannot be read as HDF5.
    """
    h5py = import_h5py()
    if not path.is_file():
        raise StoreError(f"there is no file {path}")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise StoreError(f"{path} is not an HDF5 file, or is incomplete ({error}): fetch it again") from error
    with file:
        yield file


def demonstration_names(file: Any, path: Path) -> dict[int, str]:
    """Number -> name of its group, in numeric order: demo_2 comes before demo_10.

    Raises:
        StoreError: there are none.
    """
    import h5py

    data = file.get("data")
    if not isinstance(data, h5py.Group):
        raise StoreError(f"{path} has no group `data`: it is from neither robomimic nor robosuite")
    found = {int(match[1]): name for name in data if (match := _DEMO.fullmatch(name))}
    if not found:
        raise StoreError(f"{path} holds no demonstration (no `data/demo_0` or the like)")
    return dict(sorted(found.items()))


def masks(file: Any, path: Path, names: Mapping[int, str]) -> dict[str, list[int]]:
    """Mask -> the numbers of its demonstrations, in numeric order. Raises StoreError if a demonstration is missing."""
    numbers = {name: number for number, name in names.items()}
    found = {}
    for mask in file.get("mask", ()):
        members = [name.decode() if isinstance(name, bytes) else str(name) for name in plain_array(file["mask"], mask)]
        missing = sorted(set(members) - numbers.keys())
        if missing:
            raise StoreError(f"{path}: mask {mask!r} names {missing[0]}, and there is no such demonstration")
        found[mask] = sorted(numbers[name] for name in members)
    return found


def mask_members(mask: str | None, known: Mapping[str, Sequence[int]], path: Path) -> list[int] | None:
    """The demonstrations of a mask; None stands for all. Raises UsageError if there is no such mask."""
    if mask is None:
        return None
    if mask not in known:
        raise UsageError(f"{path} has no mask {mask!r}{nearest(mask, list(known)) or '; it has none at all'}")
    return list(known[mask])


def dataset(group: Any, key: str) -> Any:
    """A dataset of numbers or text in this file itself.

    Raises:
        StoreError: it is missing, is a link, or has its numbers in another file.
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


def json_attribute(group: Any, key: str) -> dict[str, Any]:
    """A JSON attribute, such as `env_args`; {} if it is missing. Raises StoreError if it is not JSON."""
    text = group.attrs.get(key)
    if text is None:
        return {}
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError) as error:
        raise StoreError(f"{group.file.filename}: the attribute {key} of {group.name} is not JSON ({error})") from error


class Demonstrations:
    """The part of `Recordings` that robomimic and robosuite files share; subclasses read the format.

    _path: the file.
    _names: number of a demonstration -> its name.
    _problems: number of a demonstration -> what is wrong with it.
    """

    _path: Path
    remarks: Mapping[str, str] = MappingProxyType({})
    _names: Mapping[int, str]
    _problems: Mapping[int, str]

    def names(self) -> Mapping[int, str]:
        return self._names

    def problems(self) -> Mapping[int, str]:
        return self._problems

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        with open_hdf5(self._path) as file:
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
