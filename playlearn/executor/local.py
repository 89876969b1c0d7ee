"""Processes of this machine, each doing one job at a time."""

import os
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Self

from playlearn.errors import UsageError
from playlearn.executor.base import Executor, ExecutorConfig, Job, LostError, Result
from playlearn.executor.in_process import InProcessExecutor
from playlearn.executor.worker import Task, Worker, stop


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


class LocalExecutor:
    """`workers` spawned processes, each doing one job at a time; see `Executor.run`."""

    def __init__(self, workers: int, timeout: float | None = None, retries: int = 2) -> None:
        self.workers = workers
        self._timeout = timeout
        self._retries = retries
        self._workers: list[Worker] = []
        self._keep = False

    def __enter__(self) -> Self:
        self._keep = True
        return self

    def __exit__(self, *_: object) -> None:
        self._keep = False
        self._let_go()

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        pending = deque(Task(job) for job in jobs)
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
        stop(leaving)

    def _hand_out(self, pending: deque[Task], workers: list[Worker]) -> None:
        idle = [worker for worker in workers if worker.task is None]
        while pending and (idle or len(workers) < self.workers):
            if not idle:
                workers.append(Worker())
                idle.append(workers[-1])
            idle.pop().start(pending.popleft())

    def _ready(self, workers: list[Worker]) -> list[tuple[Worker, Task]]:
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

    def _lost(self, worker: Worker, task: Task, pending: deque[Task]) -> Result | None:
        """Put the job of a lost worker back in front, or give up on it."""
        overdue = worker.process.is_alive() and task.overdue(self._timeout)
        why = worker.join()
        if overdue:
            why = f"did not finish within {self._timeout:g} s"
        if task.tries <= self._retries:
            pending.appendleft(Task(task.job, task.tries + 1))
            return None
        return task.result(None, LostError(task.job, task.tries, why))
