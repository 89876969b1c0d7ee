"""Read the arrays of an .npz of any size row by row, in step; refuses arrays that would need pickle."""

import zipfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.lib import format as npy

from playlearn.episode import Array
from playlearn.errors import MissingStoreError, StoreError


class Rows:
    """Arrays with the same number of rows, read forwards; a context manager that holds the file open.

    shapes: name -> shape of one row.
    dtypes: name -> dtype.
    length: number of rows.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Raises StoreError if the file or an array is missing, damaged, or not of plain numbers."""
        self._path, self._stack = path, ExitStack()
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.dtypes: dict[str, Any] = {}
        self._streams: dict[str, Any] = {}
        lengths: dict[str, int] = {}
        try:
            archive = self._stack.enter_context(zipfile.ZipFile(path))
            for name in names:
                self._streams[name], shape, self.dtypes[name] = _begin(self._stack, archive, path, name)
                lengths[name], self.shapes[name] = shape[0], shape[1:]
        except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
            self._stack.close()
            raise StoreError(f"{path} cannot be read ({error}): fetch it again") from error
        except StoreError:
            self._stack.close()
            raise
        if len(set(lengths.values())) > 1:
            self._stack.close()
            raise StoreError(f"{path}: its arrays differ in their number of rows: {lengths}")
        self.length = next(iter(lengths.values()), 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def take(self, count: int) -> Mapping[str, Array]:
        """The next `count` rows of each."""
        return {name: self._read(name, count) for name in self._streams}

    def skip(self, count: int, at_once: int = 1 << 24) -> None:
        """Skip rows, holding no more than `at_once` bytes of them."""
        for name, stream in self._streams.items():
            left = count * self._size(name)
            while left:
                piece = stream.read(min(left, at_once))
                if not piece:
                    raise StoreError(f"{self._path}: {name} ends before its time: fetch it again")
                left -= len(piece)

    def _size(self, name: str) -> int:
        """Bytes in a row."""
        return int(np.prod(self.shapes[name], dtype=int)) * int(self.dtypes[name].itemsize)

    def _read(self, name: str, count: int) -> Array:
        wanted = count * self._size(name)
        try:
            data = self._streams[name].read(wanted)
        except (zipfile.BadZipFile, OSError, EOFError) as error:
            raise StoreError(f"{self._path}: {name} is damaged ({error}): fetch it again") from error
        if len(data) != wanted:
            raise StoreError(f"{self._path}: {name} ends before its time: fetch it again")
        return np.frombuffer(data, self.dtypes[name]).reshape(count, *self.shapes[name])


def members(path: Path) -> list[str]:
    """The names of the arrays; raises StoreError if the file is not an .npz."""
    try:
        with zipfile.ZipFile(path) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except FileNotFoundError as error:
        raise MissingStoreError(f"there is no file {path}") from error
    except (OSError, zipfile.BadZipFile) as error:
        raise StoreError(f"{path} is not an .npz file, or is incomplete ({error}): fetch it again") from error


def _begin(stack: ExitStack, archive: zipfile.ZipFile, path: Path, name: str) -> tuple[Any, tuple[int, ...], Any]:
    """A stream at the first row of an array, its shape and dtype."""
    if f"{name}.npy" not in archive.namelist():
        raise StoreError(f"{path} has no array {name!r}: it has {', '.join(members(path))}")
    stream = stack.enter_context(archive.open(f"{name}.npy"))
    version = npy.read_magic(stream)  # type: ignore[no-untyped-call]
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
    if read is None:
        raise StoreError(f"{path}: {name} is of an .npy version that is not known: {version}")
    shape, fortran, dtype = read(stream)  # type: ignore[no-untyped-call]
    if dtype.hasobject:
        raise StoreError(f"{path}: {name} holds Python objects, which are not read: they can run code")
    if dtype.kind not in "biuf":
        raise StoreError(f"{path}: {name} is of {dtype}, not of numbers")
    if fortran and len(shape) > 1:
        raise StoreError(f"{path}: {name} is stored column by column; save it again with np.ascontiguousarray")
    if not shape:
        raise StoreError(f"{path}: {name} is a single number, not rows of them")
    return stream, shape, dtype
