"""How soon a mistake in a config is told: CPU seconds of `playlearn train`, beside those of `import torch` alone.

Each is a process of its own, in alternation, on one thread.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from playlearn.bench.base import Figure, Size, measuring


def starting(size: Size) -> Iterator[Figure]:
    """A misspelled field of a training config; `import torch` is what any training waits for."""
    measuring("start of a train with a mistake in its config")
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "train.yaml")
        config.write_text("stpes: 1\n", encoding="utf-8")
        command = ("-m", "playlearn.cli", "train", "--config", str(config), "--out", str(Path(folder, "run")))
        seconds = _seconds({"ours": command, "peer": ("-c", "import torch")}, size.rounds)
    yield Figure.beside("train, until a mistake in its config is told", "s", seconds, "import torch")


def _seconds(commands: Mapping[str, Sequence[str]], rounds: int) -> dict[str, float]:
    """Name -> CPU seconds of a Python process, the median over rounds in which each has a turn."""
    seen: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(rounds):
        for name, arguments in commands.items():
            before = _of_children()
            subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
            seen[name].append(_of_children() - before)
    return {name: statistics.median(values) for name, values in seen.items()}


def _of_children() -> float:
    """CPU seconds of all ended child processes."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
