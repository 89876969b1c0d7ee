"""The one writer of a folder: while a process holds it, no other writes there."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from playlearn.config.disk import disk_errors
from playlearn.config.record import make_folder, sync_folder
from playlearn.errors import BusyError, DiskError, UsageError

LOCK = ".lock"


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Make a folder and hold it for writing; the kernel lets go of it when the process dies.

    A folder that was made here and is left empty is removed again. Where the disk is full, that is what is raised,
    whichever library found out.

    Raises:
        UsageError: it is a file.
        BusyError: another process holds it.
        DiskError: its disk is full, or it cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is there already and is no folder: name another")
    with disk_errors(folder):
        made = make_folder(folder)
        descriptor = _lock(folder)
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)
            os.close(descriptor)
            with suppress(OSError):  # the first that is not empty
                for path in made:
                    path.rmdir()


@contextmanager
def built_beside(out: Path) -> Iterator[Path]:
    """A place to build what is to appear at `out`, a file or a folder; put there in the end if nothing was raised.

    `out` itself is never seen half done. What a killed process left is removed, and nothing is left after an error.

    Raises:
        BusyError: another process builds it.
        DiskError: the disk is full, or `out` cannot be written.
    """
    place = out.with_name(f".{out.name}.building")
    built = place / out.name
    try:
        with held(place):
            _remove(built)  # of a process that was killed
            try:
                yield built
                with disk_errors(out.parent, every=True):
                    built.replace(out)
                    sync_folder(out.parent)
            finally:
                _remove(built)
    except DiskError as error:
        raise DiskError(f"{error}; nothing was left at {out}") from error
    finally:
        with suppress(OSError):  # another process holds it
            place.rmdir()


def _lock(folder: Path) -> int:
    """The descriptor of the locked file."""
    path = folder / LOCK
    while True:
        with disk_errors(folder, every=True):
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        except BlockingIOError as error:
            os.close(descriptor)
            raise BusyError(
                f"{folder} is being written by another process: wait for it to end (lock: {path})"
            ) from error
        os.close(descriptor)  # its last holder has removed it meanwhile


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
