"""Collect play with two cameras by two processes, beside one: the whole command, start-up included."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from playlearn.bench.base import Figure, Size, measuring
from playlearn.bench.collect import CAMERAS, collect_config
from playlearn.collection import collect


def spreading(size: Size) -> Iterator[Figure]:
    """One figure: two workers, whose peer is one worker."""
    measuring("collect, two workers")
    measured = {"ours": _steps_per_second(size, 2), "peer": _steps_per_second(size, 1)}
    yield Figure.beside("collect, two workers", "steps/s", measured, "one worker, the same command")


def _steps_per_second(size: Size, workers: int) -> float:
    config = collect_config(CAMERAS, size, episodes=4 * size.rounds)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        collect(config, Path(folder) / "play", workers=workers)
        return config.episodes * config.steps / (time.perf_counter() - began)
