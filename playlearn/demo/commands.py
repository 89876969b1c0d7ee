"""Several commands side by side: their output line by line, and what they cost."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

POLL = 0.2  # seconds
PLAYLEARN = (sys.executable, "-m", "playlearn.cli")


@dataclass(frozen=True)
class Done:
    """How a command ended. core_seconds: of it and its children."""

    code: int
    seconds: float
    core_seconds: float


def run_together(
    commands: Mapping[str, Sequence[str]],
    say: Callable[[str], None],
    tick: Callable[[], None],
    program: Sequence[str] = PLAYLEARN,
    optional: Collection[str] = (),
) -> dict[str, Done]:
    """Run `program ARGUMENTS...` for each name at once, to their ends; where one fails the others are stopped.

    optional: names that may fail without stopping the others.
    say: is called with each line of output, the command's name before it.
    tick: called several times a second.

    Raises:
        KeyboardInterrupt: on Ctrl-C, which the commands receive too, once all have ended.
    """
    running = {name: _start([*program, *arguments]) for name, arguments in commands.items()}
    readers = [_read(name, process, say) for name, process in running.items()]
    began, done, interrupted = time.monotonic(), dict[str, Done](), False
    while len(done) < len(running):
        try:
            for name, process in running.items():
                if name not in done and (ended := _ended(process)) is not None:
                    done[name] = Done(ended[0], time.monotonic() - began, ended[1])
                    if ended[0] != 0 and name not in optional:
                        _stop([other for key, other in running.items() if key not in done])
            tick()
            time.sleep(POLL)
        except KeyboardInterrupt:  # the whole process group receives it; each command keeps what is finished
            interrupted = True
    for reader in readers:
        reader.join()
    if interrupted:
        raise KeyboardInterrupt
    return done


def _start(command: Sequence[str]) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )


def _read(name: str, process: "subprocess.Popen[str]", say: Callable[[str], None]) -> threading.Thread:
    def relay() -> None:
        if process.stdout is not None:
            with process.stdout as lines:
                for line in lines:
                    say(f"{name} | {line.rstrip()}")

    thread = threading.Thread(target=relay, daemon=True)
    thread.start()
    return thread


def _ended(process: "subprocess.Popen[str]") -> tuple[int, float] | None:
    """Exit code and core seconds of a command that is over."""
    pid, status, usage = os.wait4(process.pid, os.WNOHANG)
    if pid == 0:
        return None
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, usage.ru_utime + usage.ru_stime


def _stop(processes: Sequence["subprocess.Popen[str]"]) -> None:
    for process in processes:
        with suppress(ProcessLookupError):
            process.terminate()
