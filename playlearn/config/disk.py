"""A disk that is full, however a library says it: told as one error that names the folder."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playlearn.errors import DiskError, PlaylearnError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def disk_errors(folder: Path, *, every: bool = False) -> Iterator[None]:
    """Turn what the block raises where the disk is full into a DiskError that names the folder.

    every: also any other OSError, for a block that does nothing but write there.
    """
    try:
        yield
    except PlaylearnError:
        raise
    except Exception as error:
        problem = disk_problem(error)
        if problem is None and every and isinstance(error, OSError):
            problem = f"cannot write ({error.strerror or error})"
        if problem is None:
            raise
        raise DiskError(f"{_place(error, folder)}: {problem}") from error


def disk_problem(error: BaseException) -> str | None:
    """What is wrong with the disk, if that is what an error means.

    PIL and pyarrow raise an OSError; safetensors, PyAV, HDF5 and LeRobot's threads raise errors of their own, with the
    system's words in their message or the OSError behind them.
    """
    one: BaseException | None = error
    while one is not None:
        message = str(one)
        if getattr(one, "errno", None) in _FULL or any(os.strerror(number) in message for number in _FULL):
            return "the disk is full"
        one = one.__cause__ or one.__context__
    return None


def _place(error: Exception, folder: Path) -> Path:
    """The folder whose disk it is: that of the named file where it is another one, such as a cache."""
    named = getattr(error, "filename", None)
    if not isinstance(named, str | Path) or Path(named).resolve().is_relative_to(folder.resolve()):
        return folder
    return Path(named).parent
