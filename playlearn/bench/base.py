"""What a benchmark is: a generator of figures. Peer and limit are measured in the same run, turn by turn."""

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
    """value, peer_value, limit_value in `unit`. ratio: value / peer_value. of_limit: value / limit_value."""

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
        """Of rates under the keys `ours`, `peer` and `limit`; the two names say what those are."""
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
        """For people."""
        words = f"{self.name:<38} {self.value:9.4g} {self.unit:<10}"
        if self.peer_value:
            words += f"  {self.ratio:5.2f} x {self.peer} ({self.peer_value:.4g})"
        if self.limit_value:
            words += f"  {self.of_limit:4.0%} of {self.limit} ({self.limit_value:.4g})"
        return words


@dataclass(frozen=True)
class Size:
    """steps: of each turn. rounds: turns of each contender, of which the median counts. episodes: of the growing store.

    worlds: what is stepped and drawn. out: where pictures are written, None for nowhere.
    """

    steps: int = 200
    rounds: int = 5
    episodes: int = 1000
    envs: tuple[str, ...] = ("playtable", "lift")
    out: Path | None = None


Benchmark = Callable[[Size], Iterator[Figure]]


@dataclass(frozen=True)
class Deferred:
    """A benchmark that is imported by the process that measures it, so that no other pays for what it needs."""

    module: str
    function: str

    def __call__(self, size: Size) -> Iterator[Figure]:
        measure: Benchmark = getattr(import_module(self.module), self.function)
        limit()  # of what that has imported
        return measure(size)


BENCHMARKS: dict[str, Benchmark] = {
    name: Deferred(f"playlearn.bench.{name}", function)
    for name, function in {
        "collect": "collecting",
        "data": "reading",
        "grow": "growing",
        "render": "rendering",
        "sim": "stepping",
        "threads": "loaded",
        "train": "training",
    }.items()
}
_BY_WORLD = ("render", "sim")  # each of the worlds by itself


def run(names: Sequence[str], size: Size, say: Callable[[Figure], None]) -> list[Figure]:
    """The figures of the named benchmarks, or of all; `say` hears each as soon as it is measured.

    Each measurement has a process of its own, on one thread: what one leaves behind (memory, OpenGL contexts) is no
    other's. What is being measured is said on stderr.

    Raises:
        UsageError: there is no benchmark of such a name.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise UsageError(f"there is no benchmark {name!r}{nearest(name, tuple(BENCHMARKS))}")
    limit()
    figures = []
    for name in names or tuple(BENCHMARKS):
        alone = [replace(size, envs=(env,)) for env in size.envs] if name in _BY_WORLD else [size]
        for one in alone:
            measuring(f"{name}{f', {one.envs[0]}' if name in _BY_WORLD else ''}: starting")
            with closing(_apart(BENCHMARKS[name], one)) as rows:
                for figure in rows:
                    say(figure)
                    figures.append(figure)
    return figures


def measuring(what: str) -> None:
    """Say on stderr what is being measured now."""
    print(f"bench: {what} ...", file=sys.stderr, flush=True)


def _apart(measure: Benchmark, size: Size) -> Generator[Figure]:
    """The figures of a benchmark in a process of its own, each as it comes."""
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_hand_over, args=(measure, size, there))
    with with_environment(environment()):
        process.start()
    there.close()
    try:
        while (figure := _next(here)) is not None:
            yield figure
        process.join()
        if process.exitcode:
            raise PlaylearnError(f"the benchmark's process ended with exit code {process.exitcode}; see above")
    finally:  # whoever stops listening stops it
        process.terminate()
        process.join()
        here.close()


def _next(pipe: Connection) -> Figure | None:
    """None where the other side has ended."""
    try:
        figure: Figure = pipe.recv()
    except EOFError:
        return None
    return figure


def _hand_over(measure: Benchmark, size: Size, pipe: Connection) -> None:
    os.dup2(2, 1)  # what MuJoCo and robosuite print is no part of the figures
    limit()  # of what the benchmark has imported
    for figure in measure(size):
        pipe.send(figure)


def rates(contenders: Mapping[str, Callable[[], tuple[int, float]]], rounds: int) -> dict[str, float]:
    """name -> how many a second, the median over rounds in which each has its turn.

    A contender does its work and returns how much it did in how many seconds. One turn of each is for warming up.
    """
    seen: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(rounds + 1):
        for name, work in contenders.items():
            done, seconds = work()
            if turn:
                seen[name].append(done / seconds)
    return {name: statistics.median(values) for name, values in seen.items()}


def timed(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began
