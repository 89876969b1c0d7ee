"""Standard output that is redirected into a file: there whole or not at all."""

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playlearn.errors import DiskError

_MORE = 1 << 16  # bytes


@contextmanager
def whole_output() -> Iterator[None]:
    """Where the disk of that file is full, nothing is added to it: half a config would be read as another one.

    Raises:
        DiskError: what was printed could not be written.
    """
    descriptor = _descriptor()
    before = 0 if descriptor is None else os.fstat(descriptor).st_size
    try:
        yield
        sys.stdout.flush()
    except Exception as error:
        if descriptor is None:
            raise
        name, full = _name(descriptor), _is_of_output(error) and _is_full(descriptor)
        if full or not _flushed():
            _forget(descriptor, before)
        if full:
            raise DiskError(f"{name}: the disk is full") from error
        raise


def _is_of_output(error: Exception) -> bool:
    """Whether `print` may have raised it: an error of the disk that names no file."""
    from playlearn.config import disk_problem  # slow to import, for a command that only prints

    return isinstance(error, OSError) and not error.filename and disk_problem(error) is not None


def _is_full(descriptor: int) -> bool:
    """Whether nothing more can be written there."""
    try:
        return os.write(descriptor, bytes(_MORE)) < _MORE
    except OSError:
        return True


def _flushed() -> bool:
    try:
        sys.stdout.flush()
    except OSError:
        return False
    return True


def _forget(descriptor: int, size: int) -> None:
    """Cut the file back, and lead what is still to be flushed when Python ends nowhere."""
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.ftruncate(descriptor, size)
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _descriptor() -> int | None:
    """The descriptor of standard output, if it has one."""
    try:
        return sys.stdout.fileno()
    except (OSError, ValueError, AttributeError):  # replaced by something else, or closed
        return None


def _name(descriptor: int) -> str:
    link = Path(f"/proc/self/fd/{descriptor}")
    return str(link.readlink()) if link.is_symlink() else "standard output"
