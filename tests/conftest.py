"""What holds for all tests."""

import os
import signal
import sys


def pytest_configure() -> None:
    """Ctrl-C reaches the processes that tests start, and each finds torch already compiled to bytecode.

    Where a shell runs the tests in the background (`make test &`) it has SIGINT ignored, and who is started from here
    would inherit that. Where Python is told to keep no bytecode, as in many containers, a process that imports torch
    compiles thousands of files first, and the tests start more than a hundred processes.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
