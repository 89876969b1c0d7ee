"""A benchmark is a generator of figures. Peer and limit are measured in the same run, in alternation."""

import os
import statistics
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from playlearn.config.schema import nearest
from playlearn.errors import PlaylearnError, UsageError
from playlearn.threads import environment, limit, with_environment


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    name: of the figure.
    value, peer_value, limit_value: in `unit`.
    unit: of the values.
    peer, limit: what they are.
    ratio: value / peer_value.
    of_limit: value / limit_value.
    """

    name: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None
    ratio: float | None = None
    limit: str | None = None
    limit_value: float | None = None
    of_limit: float | None = None

    @classmethod
    def beside(
        cls, name: str, unit: str, rates: Mapping[str, float], peer: str | None = None, limit: str | None = None
    ) -> "Figure":
        """A figure from rates under the keys `ours`, `peer` and `limit`; peer, limit: what those two are."""
        ours, other, most = rates["ours"], rates.get("peer"), rates.get("limit")
        return cls(
            name,
            ours,
            unit,
            peer if other is not None else None,
            other,
            ours / other if other else None,
            limit if most is not None else None,
            most,
            ours / most if most else None,
        )

    def line(self) -> str:
        """One line of text."""
        text = f"{self.name:<38} {self.value:9.4g} {self.unit:<10}"
        if self.peer_value:
            text += f"  {self.ratio:5.2f} x {self.peer} ({self.peer_value:.4g})"
        if self.limit_value:
            text += f"  {self.of_limit:4.0%} of {self.limit} ({self.limit_value:.4g})"
        return text


@dataclass(frozen=True)
class Size:
    """How much is measured.

    steps: of each turn.
    rounds: turns of each workload; the median counts.
    episodes: of the growing store.
    envs: environments that are stepped and rendered.
    out: folder for pictures (None: none are written).
    store: play that records `achieved`, for `settled`.
    cameras: those of the store that stand still, for `settled` (none: it reads the robot alone).
    picture: file for the misses of `settled` (None: none is written).
    """

    steps: int = 200
    rounds: int = 5
    episodes: int = 1000
    envs: tuple[str, ...] = ("playtable", "lift")
    out: Path | None = None
    store: Path | None = None
    cameras: tuple[str, ...] = ()
    picture: Path | None = None


Benchmark = Callable[[Size], Iterator[Figure]]


@dataclass(frozen=True)
class Deferred:
    """A benchmark that is imported only by the process that measures it."""

    module: str
    function: str

    def __call__(self, size: Size) -> Iterator[Figure]:
        measure: Benchmark = getattr(import_module(self.module), self.function)
        limit()  # threads of what was just imported
        return measure(size)


BENCHMARKS: dict[str, Benchmark] = {
    name: Deferred(f"playlearn.bench.{name}", function)
    for name, function in {
        "collect": "collecting",
        "data": "reading",
        "grow": "growing",
        "render": "rendering",
        "settled": "settling",
        "sim": "stepping",
        "start": "starting",
        "threads": "loaded",
        "train": "training",
        "workers": "spreading",
    }.items()
}
_ON_A_STORE = ("settled",)  # measured only where they are named
_PER_ENV = ("render", "sim")  # a process for each environment


def run(names: Sequence[str], size: Size, report: Callable[[Figure], None]) -> list[Figure]:
    """The figures of the named benchmarks, or of all; `report` gets each as soon as it is measured.

    Each measurement has its own process, on one thread, so that none inherits memory or OpenGL contexts. What is being
    measured is printed on stderr.

    Raises:
        UsageError: there is no benchmark of such a name.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise UsageError(f"there is no benchmark {name!r}{nearest(name, tuple(BENCHMARKS))}")
    limit()
    figures = []
    for name in names or tuple(name for name in BENCHMARKS if name not in _ON_A_STORE):
        sizes = [replace(size, envs=(env,)) for env in size.envs] if name in _PER_ENV else [size]
        for part in sizes:
            measuring(f"{name}{f', {part.envs[0]}' if name in _PER_ENV else ''}: starting")
            with closing(_in_process(BENCHMARKS[name], part)) as rows:
                for figure in rows:
                    report(figure)
                    figures.append(figure)
    return figures


def measuring(what: str) -> None:
    """Print on stderr what is being measured."""
    print(f"bench: {what} ...", file=sys.stderr, flush=True)


def _in_process(measure: Benchmark, size: Size) -> Generator[Figure]:
    """The figures of a benchmark in its own process, each as it comes."""
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_send_figures, args=(measure, size, there))
    with with_environment(environment()):
        process.start()
    there.close()
    try:
        while (figure := _next(here)) is not None:
            yield figure
        process.join()
        if process.exitcode:
            raise PlaylearnError(f"the benchmark's process ended with exit code {process.exitcode}; see above")
    finally:  # the caller may stop early
        process.terminate()
        process.join()
        here.close()


def _next(pipe: Connection) -> Figure | None:
    """The next figure; None if the process has ended."""
    try:
        figure: Figure = pipe.recv()
    except EOFError:
        return None
    return figure


def _send_figures(measure: Benchmark, size: Size, pipe: Connection) -> None:
    os.dup2(2, 1)  # keep prints of MuJoCo and robosuite off stdout
    limit()  # threads of what the benchmark has imported
    for figure in measure(size):
        pipe.send(figure)


def rates(workloads: Mapping[str, Callable[[], tuple[int, float]]], rounds: int) -> dict[str, float]:
    """Name -> rate a second, the median over rounds in which each workload has a turn.

    A workload returns how much it did in how many seconds. The first turn of each is for warm-up.
    """
    seen: dict[str, list[float]] = {name: [] for name in workloads}
    for turn in range(rounds + 1):
        for name, work in workloads.items():
            done, seconds = work()
            if turn:
                seen[name].append(done / seconds)
    return {name: statistics.median(values) for name, values in seen.items()}


def timed(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began
