"""Jobs in this very process: for tests and debuggers."""

import time
from collections.abc import Iterable, Iterator
from typing import Self

from playlearn.executor.base import Job, Result
from playlearn.threads import limit


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
