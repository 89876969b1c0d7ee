"""How fast, beside whom, and how near to what is possible: every figure with its peer and its limit in one run."""

from playlearn.bench.base import BENCHMARKS, Figure, Size, benchmark, run
from playlearn.bench.collect import collecting
from playlearn.bench.data import reading
from playlearn.bench.grow import growing
from playlearn.bench.render import rendering
from playlearn.bench.sim import stepping
from playlearn.bench.threads import loaded
from playlearn.bench.train import training

__all__ = [
    "BENCHMARKS",
    "Figure",
    "Size",
    "benchmark",
    "collecting",
    "growing",
    "loaded",
    "reading",
    "rendering",
    "run",
    "stepping",
    "training",
]
