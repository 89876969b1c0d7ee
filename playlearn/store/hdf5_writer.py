"""Writing HDF5 files whole or not at all, whatever the disk does."""

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from playlearn.config.record import sync_folder
from playlearn.errors import StoreError
from playlearn.store.hdf5 import import_h5py


@contextmanager
def new_hdf5(out: Path, check: Callable[[Path], None] = lambda path: None) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A new HDF5 file, open for writing, and a function that raises as soon as the disk took no more.

    It is written beside `out`, handed to `check` where the block ends well, and then moved to `out`; otherwise nothing
    is left.

    Raises:
        UsageError: h5py is not installed.
        StoreError: the disk is full, or fails.
    """
    h5py, building = import_h5py(), out.with_name(f".{out.name}.building")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with building.open("w+b", buffering=0) as raw:  # what an export that was killed has left is overwritten
            disk = _Disk(raw.fileno())
            with h5py.File(disk, "w") as file:
                yield file, disk.check
            disk.check()
            os.fsync(raw.fileno())
        check(building)
        building.replace(out)
        sync_folder(out.parent)
    except OSError as error:
        raise StoreError(f"{out} cannot be written ({error.strerror or error}): nothing was left there") from error
    finally:
        with suppress(OSError):  # a disk that was made read-only
            building.unlink(missing_ok=True)


class _Disk(io.RawIOBase):
    """What h5py writes into. A failed write is kept for `check` and HDF5 is told that all is well.

    HDF5 flushes as it closes a file; if that fails, the file stays half open and the process ends in a segmentation
    fault. After a failure nothing more is written, and zeros are read.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._at, self._size = descriptor, 0, 0
        self._error: OSError | None = None

    def check(self) -> None:
        """Raises OSError where a write has failed."""
        if self._error is not None:
            raise self._error

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        data = b"" if self._error else os.pread(self._descriptor, len(view), self._at)
        view[:] = data.ljust(len(view), b"\0")
        self._at += len(view)
        return len(view)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        self._attempt(lambda: self._write_all(view))
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        self._size = self._at if size is None else size
        self._attempt(lambda: os.ftruncate(self._descriptor, self._size))
        return self._size

    def _write_all(self, view: memoryview) -> None:
        done = 0
        while done < len(view):
            done += os.pwrite(self._descriptor, view[done:], self._at + done)

    def _attempt(self, action: Callable[[], None]) -> None:
        if self._error is None:
            try:
                action()
            except OSError as error:
                self._error = error
