"""What a benchmark is: a function that gives figures. Peer and limit are measured in the same run, turn by turn."""

import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from playlearn.config.schema import nearest
from playlearn.errors import UsageError


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
    worlds: tuple[str, ...] = ("playtable", "lift")
    out: Path | None = None


BENCHMARKS: dict[str, Callable[[Size], list[Figure]]] = {}
_BY_WORLD: set[str] = set()


def benchmark(
    name: str, *, by_world: bool = False
) -> Callable[[Callable[[Size], list[Figure]]], Callable[[Size], list[Figure]]]:
    """Register a function as the benchmark of this name; `by_world`: each of the worlds is measured by itself."""

    def register(measure: Callable[[Size], list[Figure]]) -> Callable[[Size], list[Figure]]:
        BENCHMARKS[name] = measure
        if by_world:
            _BY_WORLD.add(name)
        return measure

    return register


def run(names: Sequence[str], size: Size, say: Callable[[Figure], None]) -> list[Figure]:
    """The figures of the named benchmarks, or of all; `say` hears each as it comes.

    Each measurement has a process of its own: what one leaves behind (memory, OpenGL contexts) is no other's.

    Raises:
        UsageError: there is no benchmark of such a name.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise UsageError(f"there is no benchmark {name!r}{nearest(name, tuple(BENCHMARKS))}")
    # The software renderer would otherwise bring threads of its own, to whoever draws more at once.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    figures = []
    for name in names or tuple(BENCHMARKS):
        alone = [replace(size, worlds=(world,)) for world in size.worlds] if name in _BY_WORLD else [size]
        for one in alone:
            with ProcessPoolExecutor(1, get_context("spawn"), _to_stderr) as process:
                for figure in process.submit(BENCHMARKS[name], one).result():
                    say(figure)
                    figures.append(figure)
    return figures


def _to_stderr() -> None:
    """What MuJoCo and robosuite print is no part of the figures."""
    os.dup2(2, 1)


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
