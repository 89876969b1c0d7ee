"""The same seed-keyed jobs, on one core or many: results never depend on how many workers there are.

A worker is a process that lives as long as the run, so a job's function may cache what is slow to
build (a simulator, a policy). Each has one thread for numerics and one for
software GL: many processes of one thread are quicker than one of many, and sums come out alike.
"""

import copy
import faulthandler
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol, Self

import draccus

from playlearn.errors import PlaylearnError, UsageError
from playlearn.threads import environment, limit, with_environment

START = 120.0  # seconds beyond a job's own that a worker may take to be there and to import what it needs
_BEGUN = None  # what a worker sends before it does a job


class LostError(PlaylearnError):
    """A job whose worker died or hung every time it was tried. why: how it ended, in words."""

    def __init__(self, job: "Job", tries: int, why: str) -> None:
        super().__init__(
            f"job {job.key} (seed {job.seed}) was lost {tries} times: its worker process {why}. "
            "Is memory short (see dmesg)? Run only it with --workers 1, or with --workers 0 to see it fail here."
        )
        self.why = f"its worker process {why} (tries: {tries})"


@dataclass(frozen=True)
class Job:
    """`function(**kwargs)`, to be called in some process.

    key: names the job in results and messages. function: importable by name (module level).
    seed: the seed the job is keyed by, for the message when it cannot be done.
    """

    key: Any
    function: Callable[..., Any]
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        if "<" in getattr(self.function, "__qualname__", "<"):
            raise ValueError(f"{self.function} cannot be imported by name: a job's function stands at module level")


@dataclass(frozen=True)
class Result:
    """What a job gave. error: why it could not be done (then value is None). tries: 1 unless a worker was lost."""

    key: Any
    value: Any
    seconds: float
    tries: int = 1
    error: Exception | None = None


class Executor(Protocol):
    """Runs jobs somewhere, `workers` at a time. In a `with` block its workers live on from one `run` to the next."""

    @property
    def workers(self) -> int: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        """Yield results as they are finished, each job exactly once.

        A job whose worker died or hung runs again with the same arguments. With `keep_going`, what
        could not be done is yielded as a Result with `error` instead of being raised.

        Raises:
            LostError: a job was lost more often than it is tried again; names its key and seed.
            Exception: what a job's function raised, with the worker's traceback as a note.
        """
        ...


@dataclass(frozen=True)
class ExecutorConfig(draccus.ChoiceRegistry):
    """The base of every executor's config; `type:` in a YAML picks the kind."""

    def build(self) -> Executor:
        raise NotImplementedError


@ExecutorConfig.register_subclass("local")
@dataclass(frozen=True)
class LocalExecutorConfig(ExecutorConfig):
    """Processes of this machine.

    workers: how many (null: one for each core this process may use; 0: none, in this process).
    timeout: seconds after its start after which a job counts as hung (null: never).
    retries: further tries of a job whose worker was lost.
    """

    workers: int | None = None
    timeout: float | None = None
    retries: int = 2

    def build(self) -> Executor:
        if self.workers is not None and self.workers < 0:
            raise UsageError(f"workers is {self.workers}; give 0 (in this process) or more, or leave it out")
        if self.workers == 0:
            return InProcessExecutor()
        return LocalExecutor(self.workers or available_cores(), self.timeout, self.retries)


def available_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class InProcessExecutor:
    """One job after the other in this process, on one thread as in any worker: for tests and debuggers."""

    workers = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        for job in jobs:
            limit()
            started = time.perf_counter()
            try:
                value, error = job.function(**job.kwargs), None
            except Exception as raised:
                if not keep_going:
                    raise
                value, error = None, raised
            yield Result(job.key, value, time.perf_counter() - started, error=error)


class LocalExecutor:
    """`workers` spawned processes, each doing one job at a time; see `Executor.run`."""

    def __init__(self, workers: int, timeout: float | None = None, retries: int = 2) -> None:
        self.workers = workers
        self._timeout = timeout
        self._retries = retries
        self._workers: list[_Worker] = []
        self._keep = False

    def __enter__(self) -> Self:
        self._keep = True
        return self

    def __exit__(self, *_: object) -> None:
        self._keep = False
        self._let_go()

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        pending = deque(_Task(job) for job in jobs)
        workers = self._workers
        try:
            while pending or any(worker.task for worker in workers):
                self._hand_out(pending, workers)
                for worker, task in self._ready(workers):
                    result = worker.collect(task)
                    if result is None and (worker.dead() or task.overdue(self._timeout)):
                        workers.remove(worker)
                        result = self._lost(worker, task, pending)
                    if result is None:
                        continue
                    if result.error is not None and not keep_going:
                        raise result.error
                    yield result
        finally:
            self._let_go()  # also after Ctrl-C, or when the caller stops iterating

    def _let_go(self) -> None:
        """Stop the workers; inside a `with` block only those that are busy."""
        leaving = [worker for worker in self._workers if not self._keep or worker.task is not None]
        self._workers = [worker for worker in self._workers if worker not in leaving]
        _stop(leaving)

    def _hand_out(self, pending: deque["_Task"], workers: list["_Worker"]) -> None:
        idle = [worker for worker in workers if worker.task is None]
        while pending and (idle or len(workers) < self.workers):
            if not idle:
                workers.append(_Worker())
                idle.append(workers[-1])
            idle.pop().start(pending.popleft())

    def _ready(self, workers: list["_Worker"]) -> list[tuple["_Worker", "_Task"]]:
        """The busy workers that answered, died or are overdue; waits until there is one."""
        busy = [(worker, worker.task) for worker in workers if worker.task is not None]
        until = None
        if self._timeout is not None:
            until = max(0.0, min(task.started for _, task in busy) + self._timeout - time.perf_counter())
        signs = [sign for worker, _ in busy for sign in (worker.pipe, worker.process.sentinel)]
        seen = set(wait(signs, until))
        return [
            (worker, task)
            for worker, task in busy
            if seen & {worker.pipe, worker.process.sentinel} or task.overdue(self._timeout)
        ]

    def _lost(self, worker: "_Worker", task: "_Task", pending: deque["_Task"]) -> Result | None:
        """Put the job of a lost worker back in front, or give up on it."""
        overdue = worker.process.is_alive() and task.overdue(self._timeout)
        why = worker.join()
        if overdue:
            why = f"did not finish within {self._timeout:g} s"
        if task.tries <= self._retries:
            pending.appendleft(_Task(task.job, task.tries + 1))
            return None
        return task.result(None, LostError(task.job, task.tries, why))


@dataclass
class _Task:
    """A job on its way: how often it was handed out, and when last."""

    job: Job
    tries: int = 1
    started: float = 0.0

    def overdue(self, timeout: float | None) -> bool:
        return timeout is not None and time.perf_counter() - self.started >= timeout

    def result(self, value: Any, error: Exception | None) -> Result:
        return Result(self.job.key, value, time.perf_counter() - self.started, self.tries, error)


class _Worker:
    """A process and this end of its pipe."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs,), daemon=True)
        with with_environment(environment()), _ctrl_c_held_back():
            self.process.start()
        theirs.close()
        self.task: _Task | None = None
        self._silent = False

    def start(self, task: _Task) -> None:
        self.task, task.started = task, time.perf_counter() + START  # until it reports that it has begun
        # One that died while idle: its sentinel shows it, and the job is handed out again.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send((task.job.function, dict(task.job.kwargs)))

    def collect(self, task: _Task) -> Result | None:
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


def _stop(workers: list[_Worker]) -> None:
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


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
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
