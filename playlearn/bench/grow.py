"""Whether a store's thousandth episode costs as much time and memory as its first."""

import gc
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from playlearn.bench.base import Figure, Size, measuring
from playlearn.collection import CollectConfig, collect, play
from playlearn.envs import PlayTableConfig
from playlearn.store import NativeStore

PART = 50
STEPS = 10


def growing(size: Size) -> Iterator[Figure]:
    """Episodes a second and memory of the last PART episodes of many; the peer is the first PART of the same store."""
    measuring(f"{size.episodes} episodes of one store")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "play"
        config = CollectConfig(environment=PlayTableConfig(), episodes=1, steps=STEPS)
        collect(config, out, workers=0)
        store = NativeStore.open(out)
        seconds, memory = [], []
        with store.writer() as writer:
            for index in range(1, size.episodes + 1):
                began = time.perf_counter()
                writer.append(play(config, index), index)
                seconds.append(time.perf_counter() - began)
                memory.append(_resident())
        gc.collect()
    part = min(PART, len(seconds) // 2)
    # The median, as one episode in ten draws its start state twice or more.
    first, last = (1 / float(np.median(own)) for own in (seconds[:part], seconds[-part:]))
    before, after = (float(np.median(own)) for own in (memory[part : 2 * part], memory[-part:]))
    yield Figure.beside(
        f"episodes {size.episodes - part} to {size.episodes} of one store",
        "episodes/s",
        {"ours": last, "peer": first},
        f"its first {part}",
    )
    yield Figure.beside("memory by then", "MiB", {"ours": after, "peer": before}, f"after {2 * part} episodes")


def _resident() -> float:
    """Resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20
