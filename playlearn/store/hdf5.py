"""HDF5 files of robosuite and robomimic: a group for each demonstration, `data/demo_12`; only plain arrays are read."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import nearest
from playlearn.episode import Array, Episode
from playlearn.errors import EpisodeError, MissingStoreError, StoreError, UsageError

_DEMO = re.compile(r"demo_(\d+)")
_UNKNOWN = "left out: playlearn has no place for it"


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
        raise MissingStoreError(f"there is no file {path}")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise StoreError(f"{path} is not an HDF5 file, or is incomplete ({error}): fetch it again") from error
    with file:
        yield file


def demonstration_names(file: Any, path: Path) -> dict[int, str]:
    """Number -> name of its group, in numeric order: demo_2 comes before demo_10.

    Raises:
        StoreError: there are none, or two of one number (demo_1 and demo_01).
    """
    import h5py

    data = file.get("data")
    if not isinstance(data, h5py.Group):
        raise StoreError(f"{path} has no group `data`: it is from neither robomimic nor robosuite")
    found: dict[int, str] = {}
    for name in data:
        if match := _DEMO.fullmatch(name):
            if int(match[1]) in found:
                raise StoreError(f"{path}: {found[int(match[1])]} and {name} are of one number: rename one of them")
            found[int(match[1])] = name
    if not found:
        raise StoreError(f"{path} holds no demonstration (no `data/demo_0` or the like)")
    return dict(sorted(found.items()))


def demonstration(data: Any, name: str) -> Any:
    """The group of a demonstration; raises StoreError if it is a link or no group."""
    import h5py

    where = f"{data.file.filename}: {name}"
    if not isinstance(data.get(name, getlink=True), h5py.HardLink):
        raise StoreError(f"{where} is a link, which is not followed")
    if not isinstance(data[name], h5py.Group):
        raise StoreError(f"{where} is an array, not a group of them")
    return data[name]


def unread(file: Any, names: Mapping[int, str], read: Sequence[str]) -> dict[str, str]:
    """What is in the file and is not read -> why.

    read: what is read of a demonstration, or is known to say nothing new.
    """
    found = {name: _UNKNOWN for name in file if name not in ("data", "mask")}
    found |= {f"data/{name}": "left out: it is not named like a demonstration (demo_0)" for name in file["data"]}
    for name in names.values():
        del found[f"data/{name}"]
        try:
            found |= {key: _UNKNOWN for key in demonstration(file["data"], name) if key not in read}
        except StoreError:  # reported with the demonstrations that are broken
            continue
    return found


def masks(file: Any, path: Path, names: Mapping[int, str]) -> dict[str, list[int]]:
    """Mask -> the numbers of its demonstrations, in numeric order. Raises StoreError if a demonstration is missing."""
    import h5py

    group = file.get("mask")
    if group is None:
        return {}
    if not isinstance(group, h5py.Group):
        raise StoreError(f"{path}: mask is an array, not a group of them")
    numbers = {name: number for number, name in names.items()}
    found = {}
    for mask in group:
        members = [name.decode() if isinstance(name, bytes) else str(name) for name in plain_array(group, mask).ravel()]
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


def grouped(remarks: Mapping[str, str]) -> dict[str, str]:
    """One remark for all that share it."""
    owners: dict[str, list[str]] = {}
    for name, why in remarks.items():
        owners.setdefault(why, []).append(name)
    return {", ".join(names): why for why, names in owners.items()}


# An episode ends with an observation, a demonstration of theirs with an action.
LAST = {
    "actions": "left out: the last one of a demonstration and its reward, where no observation follows it; "
    "an export writes them back"
}


def beyond_mask(mask: str | None, chosen: int, total: int) -> dict[str, str]:
    """What an import of one mask leaves out."""
    left = total - chosen
    return {"demonstrations": f"left out: {left} of {total}, as they are not in mask {mask!r}"} if left else {}


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
    if place.shape is None:
        raise StoreError(f"{where} is empty")
    return place


def numbers_problem(one: Any, shape: Sequence[int]) -> str:
    """What keeps a dataset from being real numbers, or truth values, of this shape; "" if nothing does."""
    if one.shape != tuple(shape):
        return f"has shape {one.shape}, not {tuple(shape)}"
    return "" if is_numeric(one) else f"is of {one.dtype}, not of numbers"


def is_numeric(one: Any) -> bool:
    """Whether a dataset holds real numbers or truth values."""
    return one.dtype.kind in "biuf"


def plain_array(group: Any, key: str) -> Array:
    """All of it, in memory."""
    return np.asarray(dataset(group, key)[()])


def json_attribute(group: Any, key: str) -> dict[str, Any]:
    """A JSON attribute, such as `env_args`; {} if it is missing. Raises StoreError if it is not JSON."""
    text = group.attrs.get(key)
    if text is None:
        return {}
    try:
        return dict(json.loads(text).items())
    except (TypeError, ValueError, AttributeError) as error:
        raise StoreError(
            f"{group.file.filename}: the attribute {key} of {group.name} is no JSON object ({error})"
        ) from error


def frequency(given: float | None, stated: Any, path: Path, otherwise: float) -> float:
    """Control steps a second: as given, else as the file states it, else as is usual.

    Raises:
        StoreError: the file states something else than a frequency.
        UsageError: so does the user.
    """
    if given is not None and not 0 < given < float("inf"):
        raise UsageError(f"fps must be above 0, got {given:g}")
    value = given if given is not None else otherwise if stated is None else stated
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise StoreError(f"{path} states control_freq {value!r}, which is no frequency: say --fps")
    return float(value)


class Demonstrations:
    """The part of `Recordings` that robomimic and robosuite files share; subclasses read the format.

    _path: the file.
    _names: number of a demonstration -> its name.
    _problems: number of a demonstration -> what is wrong with it.
    remarks: array -> why it is left out, or not called what it is called there.
    """

    _path: Path
    _names: Mapping[int, str]
    _problems: Mapping[int, str]
    remarks: Mapping[str, str]

    def names(self) -> Mapping[int, str]:
        return self._names

    def problems(self) -> Mapping[int, str]:
        return self._problems

    def read(self, numbers: Sequence[int]) -> Iterator[tuple[int, Episode | StoreError]]:
        with open_hdf5(self._path) as file:
            for number in numbers:
                name = f"{self._path}: {self._names[number]}"
                try:
                    yield number, self._episode(demonstration(file["data"], self._names[number]), number, name)
                except (EpisodeError, OSError, ValueError, TypeError) as error:
                    yield number, StoreError(f"{name}: {error}")
                except StoreError as error:
                    yield number, error

    def _episode(self, group: Any, number: int, name: str) -> Episode:
        """One demonstration, called `name` in messages."""
        raise NotImplementedError
