"""Benchmarks that take no time, in a module of their own so that their process imports nothing else."""

import os
import time
from collections.abc import Iterator

from playlearn.bench.base import Figure, Size


def two_rows(size: Size) -> Iterator[Figure]:
    """The second is measured only after the first was received."""
    yield Figure("first", os.getpid(), "process")
    assert size.out is not None
    until = time.monotonic() + 60
    while not (size.out / "heard").exists() and time.monotonic() < until:
        time.sleep(0.02)
    yield Figure("second", float((size.out / "heard").exists()), "heard")


def breaks(_size: Size) -> Iterator[Figure]:
    yield Figure("first", 1.0, "row")
    raise ZeroDivisionError("in the benchmark")
