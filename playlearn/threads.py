"""How many threads a process computes with: torch, BLAS, numba and software GL alike, one unless a job sets more.

One thread for each core is faster on an idle machine, and far slower as soon as anything else runs: the threads of one
operation wait for the one that is not scheduled. Several processes of one thread each use the cores better, and what
they compute depends neither on the number of cores nor on how many processes there are.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_NUMERICS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
_MAPS = Path("/proc/self/maps")
# As OpenBLAS calls them by itself, in numpy's wheels and in scipy's.
_OPENBLAS = tuple((f"{scipy}openblas_", wide) for scipy in ("", "scipy_") for wide in ("", "64_"))


def environment(threads: int = 1) -> dict[str, str]:
    """What a process must find in its environment when it starts."""
    # LP_NUM_THREADS is that of llvmpipe, Mesa's software GL: 0 draws in the calling thread, without handing over.
    return {**dict.fromkeys(_NUMERICS, str(threads)), "LP_NUM_THREADS": "0" if threads == 1 else str(threads)}


@contextmanager
def with_environment(variables: Mapping[str, str]) -> Iterator[None]:
    """`os.environ` with these variables while a child is started, which inherits them."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def limit(threads: int = 1) -> None:
    """Let this process compute with so many threads, and the processes that it starts from now on.

    A library that is not imported yet reads the environment later. One that is gets the number through its own
    functions: torch, numba (for the calling thread), and every OpenBLAS (found on Linux only). torch's inter-op threads
    are always one, as nothing here uses more; no variable sets them, so this is called again once torch is imported.
    llvmpipe reads its variable when the first context is made.
    """
    torch, numba = sys.modules.get("torch"), sys.modules.get("numba")
    variables = environment(threads)
    if numba is not None:  # it reads its variable with every compilation, and refuses another number
        del variables["NUMBA_NUM_THREADS"]
    os.environ.update(variables)
    if torch is not None:
        torch.set_num_threads(threads)
        if torch.get_num_interop_threads() != 1:
            with suppress(RuntimeError):  # they were used before, so their number is fixed
                torch.set_num_interop_threads(1)
    if numba is not None and numba.config.NUMBA_NUM_THREADS > 1:  # as many as it was imported with; fewer can be used
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    for set_threads, _ in _openblas(len(sys.modules)):
        set_threads(threads)


def in_force() -> dict[str, int]:
    """Threads of everything numerical that is loaded: `torch`, `torch_interop`, `numba`, `openblas` (the most of all).

    Call it last: numba starts its threads in order to count them.
    """
    found: dict[str, int] = {}
    if "torch" in sys.modules:
        import torch

        found |= {"torch": torch.get_num_threads(), "torch_interop": torch.get_num_interop_threads()}
    if "numba" in sys.modules:
        import numba

        found["numba"] = numba.get_num_threads()
    counts = [int(get_threads()) for _, get_threads in _openblas(len(sys.modules))]
    return found | ({"openblas": max(counts)} if counts else {})


@functools.lru_cache(maxsize=1)
def _openblas(_modules: int) -> list[tuple[Callable[[int], Any], Callable[[], Any]]]:
    """Of each OpenBLAS in this process, how its threads are set and asked for.

    _modules: how many are imported; while they are as many, no further library was loaded.
    """
    if not _MAPS.exists():
        return []
    # Thousands of lines: only those of a file of such a name are parsed.
    lines = _MAPS.read_text(encoding="utf-8", errors="replace").splitlines()
    files = {line.split(maxsplit=5)[5] for line in lines if "openblas" in line.rpartition("/")[2]}
    found = (_functions(file) for file in sorted(files))
    return [functions for functions in found if functions is not None]


@functools.cache
def _functions(file: str) -> tuple[Callable[[int], Any], Callable[[], Any]] | None:
    library = ctypes.CDLL(file)
    for before, after in _OPENBLAS:
        if hasattr(library, f"{before}set_num_threads{after}"):
            names = (f"{before}{verb}_num_threads{after}" for verb in ("set", "get"))
            set_threads, get_threads = (getattr(library, name) for name in names)
            return set_threads, get_threads
    return None
