"""The same seed-keyed jobs, on one core or many: results never depend on how many workers there are.

A worker is a process that lives as long as the run, so a job's function may cache what is slow to
build (a simulator, a policy). Each has one thread for numerics and one for
software GL: many processes of one thread are quicker than one of many, and sums come out alike.
"""

from playlearn.executor.base import Executor, ExecutorConfig, Job, LostError, Result
from playlearn.executor.in_process import InProcessExecutor
from playlearn.executor.interruption import interruption_deferred
from playlearn.executor.local import LocalExecutor, LocalExecutorConfig, available_cores

__all__ = [
    "Executor",
    "ExecutorConfig",
    "InProcessExecutor",
    "Job",
    "LocalExecutor",
    "LocalExecutorConfig",
    "LostError",
    "Result",
    "available_cores",
    "interruption_deferred",
]
