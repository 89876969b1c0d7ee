"""Benchmarks: every figure beside a peer and a limit, measured in one run."""

import playlearn.sim  # noqa: F401 - says how to draw, before a benchmark imports MuJoCo
from playlearn.bench.base import BENCHMARKS, Figure, Size, run

__all__ = ["BENCHMARKS", "Figure", "Size", "run"]
