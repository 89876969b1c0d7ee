"""Several commands side by side: what they say line by line, what they cost."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
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
    commands: Mapping[str, Sequence[Sequence[str]]],
    say: Callable[[str], None],
    tick: Callable[[], None],
    program: Sequence[str] = PLAYLEARN,
) -> dict[str, Done]:
    """Run `program ARGUMENTS...`: of each name one after the other, the names at once; where one fails all are stopped.

    say: hears each line with the command's name before it. tick: called several times a second.

    Raises:
        KeyboardInterrupt: on Ctrl-C, which the commands hear too, once all have ended.
    """
    chains = {name: [[*program, *arguments] for arguments in chain] for name, chain in commands.items()}
    running, readers, done = dict[str, "subprocess.Popen[str]"](), list[threading.Thread](), dict[str, Done]()
    began, spent, interrupted = time.monotonic(), dict.fromkeys(chains, 0.0), False

    def start(name: str) -> None:
        running[name] = _start(chains[name].pop(0))
        readers.append(_read(name, running[name], say))

    for name in chains:
        start(name)
    while running:
        try:
            for name, process in list(running.items()):
                if (ended := _ended(process)) is None:
                    continue
                del running[name]
                spent[name] += ended[1]
                if ended[0] != 0:
                    _stop(list(running.values()))
                    chains = {key: [] for key in chains}  # nothing more is begun
                if ended[0] == 0 and chains[name] and not interrupted:
                    start(name)
                else:
                    done[name] = Done(ended[0], time.monotonic() - began, spent[name])
            tick()
            time.sleep(POLL)
        except KeyboardInterrupt:  # the whole group has heard it; each command keeps what is finished
            interrupted = True
    for reader in readers:
        reader.join()
    if interrupted:
        raise KeyboardInterrupt
    return done


def _start(words: Sequence[str]) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        words,
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
