"""One spawned process and this end of its pipe; and what that process does."""

import copy
import faulthandler
import multiprocessing
import os
import signal
import threading
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from playlearn.errors import PlaylearnError
from playlearn.executor.base import Job, Result
from playlearn.executor.interruption import ctrl_c_held_back
from playlearn.threads import environment, limit, with_environment

START = 120.0  # seconds beyond a job's own that a worker may take to be there and to import what it needs
_BEGUN = None  # what a worker sends before it does a job


@dataclass
class Task:
    """A job on its way: how often it was handed out, and when last."""

    job: Job
    tries: int = 1
    started: float = 0.0

    def overdue(self, timeout: float | None) -> bool:
        return timeout is not None and time.perf_counter() - self.started >= timeout

    def result(self, value: Any, error: Exception | None) -> Result:
        return Result(self.job.key, value, time.perf_counter() - self.started, self.tries, error)


class Worker:
    """A process and this end of its pipe."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs,), daemon=True)
        with with_environment(environment()), ctrl_c_held_back():
            self.process.start()
        theirs.close()
        self.task: Task | None = None
        self._silent = False

    def start(self, task: Task) -> None:
        self.task, task.started = task, time.perf_counter() + START  # until it reports that it has begun
        # One that died while idle: its sentinel shows it, and the job is handed out again.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send((task.job.function, dict(task.job.kwargs)))

    def collect(self, task: Task) -> Result | None:
        """The finished job's result; None where there is none."""
        try:
            while self.pipe.poll():
                message = self.pipe.recv()
                if message is not _BEGUN:
                    self.task = None
                    return task.result(*message)
                task.started = time.perf_counter()
        except (EOFError, OSError):
            self._silent = True
        return None

    def dead(self) -> bool:
        """Whether nothing more will come from it."""
        return self._silent or not self.process.is_alive()

    def join(self) -> str:
        """Make sure that a lost worker is gone; how it ended, in words."""
        self.process.join(timeout=0.1)  # its pipe may close a moment before it is dead
        self.process.kill()
        self.process.join()
        self.pipe.close()
        code = self.process.exitcode or 0
        return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def stop(self) -> None:
        """Let an idle worker end; terminate one that is still busy."""
        try:
            if self.task is None:
                self.pipe.send(None)
            else:
                self.process.terminate()
        except OSError:
            self.process.kill()


def stop(workers: list[Worker]) -> None:
    for worker in workers:
        worker.stop()
    for worker in workers:
        worker.process.join(timeout=5)
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()


def _serve(pipe: Connection) -> None:
    """A worker's main loop: do jobs until asked to stop or until the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    faulthandler.enable()  # a crash in compiled code prints a traceback
    threading.Thread(target=_die_with_parent, daemon=True).start()
    while True:
        try:
            message = pipe.recv()
        except (EOFError, OSError):
            return
        if message is None:
            return
        function, kwargs = message
        limit()  # of what the function has imported, and whatever the job before has asked for
        _answer(pipe, _BEGUN)
        try:
            answer: tuple[Any, Exception | None] = (function(**kwargs), None)
        except Exception as error:  # noqa: BLE001 - whatever it is, the parent raises it
            error.add_note(f"in a worker process:\n{traceback.format_exc()}")
            answer = (None, _portable(error))
        _answer(pipe, answer)


def _die_with_parent() -> None:
    """End with a killed parent: an orphan would still write where another run may write by now."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _answer(pipe: Connection, answer: tuple[Any, Exception | None] | None) -> None:
    try:
        pipe.send(answer)
    except OSError:
        return  # the parent is gone
    except Exception as error:  # noqa: BLE001 - a value that cannot travel between processes
        pipe.send((None, PlaylearnError(f"a job's answer cannot be sent: {error}; it was {answer!r:.500}")))


def _portable(error: Exception) -> Exception:
    """The error itself where it can be built again from its arguments, else one that quotes it."""
    try:
        copy.copy(error)  # by the same means as the pipe
    except Exception:  # noqa: BLE001 - its own code runs here
        return RuntimeError("".join(traceback.format_exception(error)))
    return error
