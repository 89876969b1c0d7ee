"""Standard output that is redirected into a file: there whole or not at all."""

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playlearn.errors import DiskError


@contextmanager
def whole_output() -> Iterator[None]:
    """Where the disk of that file is full, nothing is added to it: half a config would be read as another one.

    Raises:
        DiskError: what was printed could not be written.
    """
    descriptor = _file()
    before = 0 if descriptor is None else os.fstat(descriptor).st_size
    try:
        yield
        sys.stdout.flush()
    except Exception as error:
        problem = None if descriptor is None else _problem()
        if descriptor is None or problem is None:
            raise
        name = _name(descriptor)
        os.ftruncate(descriptor, before)
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)  # Python flushes once more when it ends
        raise DiskError(f"{name}: {problem}") from error


def _file() -> int | None:
    """The descriptor of standard output, if that is a file."""
    try:
        descriptor = sys.stdout.fileno()
        return descriptor if stat.S_ISREG(os.fstat(descriptor).st_mode) else None
    except (OSError, ValueError, AttributeError):  # replaced by something else, or closed
        return None


def _problem() -> str | None:
    """What is wrong with the disk of standard output; None where everything printed has been written."""
    from playlearn.config import disk_problem  # slow to import, for a command that only prints

    try:
        sys.stdout.flush()
    except OSError as error:
        return disk_problem(error)
    return None


def _name(descriptor: int) -> str:
    link = Path(f"/proc/self/fd/{descriptor}")
    return str(link.readlink()) if link.is_symlink() else "standard output"
