"""Ctrl-C and SIGTERM, where they must not strike at once."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def ctrl_c_held_back() -> Iterator[None]:
    """A process started here begins with SIGINT blocked: until it ignores it, no Ctrl-C can end it."""
    resource_tracker.ensure_running()  # starting a process starts that first, which would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def interruption_deferred() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C into an event, so that no update is cut in half; the second one acts as usual."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    kinds = (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.getsignal(kind) for kind in kinds}

    def restore() -> None:
        for kind, handler in before.items():
            signal.signal(kind, handler)

    def ask(_number: int, _frame: object) -> None:
        asked.set()
        restore()

    for kind in kinds:
        signal.signal(kind, ask)
    try:
        yield asked
    finally:
        restore()
