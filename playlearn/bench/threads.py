"""Updates a second beside another busy process: the threads that `playlearn train` chooses, beside one thread.

The other program is one process that never waits. The policy is a small state policy, as in
configs/train/playtable_state_diffusion.yaml, and its batch is held in memory. Seconds are wall-clock time, to include
the time lost by waiting for a thread that is not scheduled.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from playlearn.bench.base import Figure, Size, measuring, rates
from playlearn.bench.train import an_update, build_policy
from playlearn.executor import available_cores
from playlearn.policies import PolicyConfig
from playlearn.policies.encoders import StateConfig
from playlearn.policies.heads import DiffusionConfig
from playlearn.policies.trunks import TransformerConfig
from playlearn.threads import limit
from playlearn.training import TrainConfig

EXAMPLES = 128
POLICY = PolicyConfig(
    encoder=StateConfig(hidden=128),
    trunk=TransformerConfig(width=64, layers=2),
    head=DiffusionConfig(width=256, blocks=2, sample_steps=8, noise_draws=4),
    chunk=8,
)
# Runs until it is killed or its parent has ended.
_BUSY = "import os; own = os.getppid(); print(flush=True)\nwhile os.getppid() == own: pass"


def loaded(size: Size) -> Iterator[Figure]:
    """Our default and torch's own (a thread a core), each beside one thread; the limit is one thread undisturbed."""
    ours, cores = TrainConfig().threads, available_cores()
    measuring("train beside a busy process")
    update = an_update(build_policy(POLICY), min(EXAMPLES, size.steps))
    updates = max(1, size.steps // 10)
    turns = {
        "ours": partial(_beside, update, updates, ours),
        "cores": partial(_beside, update, updates, cores),
        "peer": partial(_beside, update, updates, 1),
        "limit": partial(_turn, update, updates, 1),
    }
    measured = rates(turns, size.rounds)
    for name, own in ((f"our default, {ours} thread{'s' if ours > 1 else ''}", "ours"), (f"{cores} threads", "cores")):
        figures = {**measured, "ours": measured[own]}
        yield Figure.beside(
            f"train beside a busy process, {name}", "updates/s", figures, "one thread", "one undisturbed"
        )


def _turn(update: Callable[[], None], updates: int, threads: int) -> tuple[int, float]:
    limit(threads)
    update()  # warm-up: starts the threads
    began = time.perf_counter()
    for _ in range(updates):
        update()
    return updates, time.perf_counter() - began


def _beside(update: Callable[[], None], updates: int, threads: int) -> tuple[int, float]:
    with _busy():
        return _turn(update, updates, threads)


@contextmanager
def _busy() -> Iterator[None]:
    """One process that never waits."""
    with subprocess.Popen([sys.executable, "-c", _BUSY], stdout=subprocess.PIPE) as other:
        try:
            if other.stdout is not None:
                other.stdout.readline()  # it has started
            yield
        finally:
            other.kill()
