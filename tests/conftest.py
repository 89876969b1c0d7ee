"""What holds for all tests."""

import signal


def pytest_configure() -> None:
    """Ctrl-C reaches the processes that tests start, also where a shell runs them in the background (`make test &`).

    There the shell has SIGINT ignored, and who is started from here would inherit that.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
