"""The `playlearn` command. Each verb imports what it needs when it runs, so that `--help` stays quick.

Exit codes: 0 done, 1 the job failed, 2 bad usage or config, 130 interrupted (what was finished is kept).
"""

import os
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from playlearn.cli.output import whole_output
from playlearn.cli.parser import parse
from playlearn.cli.verb import FAILED, INTERRUPTED, USAGE
from playlearn.errors import DiskError, PlaylearnError, UsageError
from playlearn.threads import limit

DEBUG = "PLAYLEARN_DEBUG"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; a mistake ends in one message on stderr, not a traceback."""
    kept = ""
    try:
        with _termination_as_interrupt(), whole_output():
            try:
                arguments = parse(argv)
            except SystemExit as stop:  # argparse has said why, or printed its help
                return int(stop.code or 0)
            kept = arguments.kept
            limit()  # before anything numerical is imported
            code: int = arguments.command(arguments)
            return code
    except KeyboardInterrupt:
        return _say(f"interrupted{kept}", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output went away: `playlearn info STORE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        message = _explain(error, kept)
        if message is None:
            raise
        return _say(message, USAGE if isinstance(error, UsageError) else FAILED)


def _explain(error: Exception, kept: str) -> str | None:
    """The message of an error that a user can mend; None for one that is ours. kept: see `Verb`."""
    from playlearn.config import disk_problem  # slow to import, and seldom needed

    advice = kept or ". Make room, and run the same command again"
    if isinstance(error, DiskError):
        return f"{error}{advice}"
    if isinstance(error, PlaylearnError):
        return str(error)
    problem = disk_problem(error)
    if problem is not None:
        return f"{getattr(error, 'filename', None) or 'a folder of this command'}: {problem}{advice}"
    if isinstance(error, OSError) and error.filename:
        return f"{error.strerror or error}: {error.filename}"
    return None


def _say(message: str, code: int) -> int:
    if os.environ.get(DEBUG):
        traceback.print_exc()
    print(f"playlearn: {message}", file=sys.stderr)
    return code


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """SIGTERM ends a job as Ctrl-C does: cleanly, with what was finished kept."""

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    try:
        former = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not the main thread, and only that may set a handler
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, former)
