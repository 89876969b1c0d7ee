"""What holds for all tests."""

import os
import shutil
import signal
import sys
from pathlib import Path

import pytest

_MEMORY = Path("/dev") / "shm"


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Of several processes (`-n 2`) each begins with its own part of the files, and takes from the other's end.

    So what a module's tests share is made once, not once in every process.
    """
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist = "worksteal"


def pytest_configure() -> None:
    """Ctrl-C reaches the processes that tests start, and each finds torch already compiled to bytecode.

    Where a shell runs the tests in the background (`make test &`) it has SIGINT ignored, and who is started from here
    would inherit that. Where Python is told to keep no bytecode, as in many containers, a process that imports torch
    compiles thousands of files first, and the tests start more than a hundred processes. Temporary folders lie in
    memory where there is room: everything that is stored is synced to the disk, which would take a tenth of the time.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if _MEMORY.is_dir() and shutil.disk_usage(_MEMORY).free > 4 << 30:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_MEMORY))
