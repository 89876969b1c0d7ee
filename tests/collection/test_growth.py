"""The thousandth episode costs what the third one did: in work, in system calls and in memory."""

import contextlib
import gc
import statistics
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from playlearn.collection import CollectConfig, collect, job
from playlearn.store import NativeStore, StoreSpec
from tests.fakes import PointConfig, PointPlayPolicy
from tests.synthetic import make_episode


class Counter:
    """Counts calls of functions, compiled ones too, and what they ask of the system."""

    def __init__(self) -> None:
        self.calls = 0
        self.asked: list[str] = []
        self._on = False
        sys.addaudithook(self._audit)  # stays for good, so it must be quiet when nothing is counted

    @contextlib.contextmanager
    def counting(self) -> Iterator[None]:
        self._on, before = True, sys.getprofile()
        sys.setprofile(self._profile)
        try:
            yield
        finally:
            sys.setprofile(before)
            self._on = False

    def _profile(self, _frame: FrameType, event: str, _argument: Any) -> None:
        self.calls += event in {"call", "c_call"}

    def _audit(self, event: str, _arguments: tuple[Any, ...]) -> None:
        if self._on and event.partition(".")[0] in {"open", "os", "shutil", "glob"}:
            self.asked.append(event)


@pytest.fixture(scope="module")
def counter() -> Counter:
    return Counter()


@pytest.mark.slow
def test_an_append_costs_the_same_however_many_are_there(tmp_path: Path, counter: Counter) -> None:
    """Not one call and not one system call more at 100 episodes than at 3; above all, nothing is listed."""
    episode = make_episode(np.random.default_rng(0), 5)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    work, asked = [], []
    with store.writer() as writer:
        for _ in range(100):
            before, counter.asked = counter.calls, []
            with counter.counting():
                writer.append(episode)
            work.append(counter.calls - before)
            asked.append(counter.asked)
    assert work[-1] == work[3]
    assert asked[-1] == asked[3]
    assert "os.rename" in asked[3]
    assert not {"os.listdir", "os.scandir"} & {event for events in asked for event in events}


@pytest.mark.slow
def test_an_open_store_grows_by_what_it_must_know_of_an_episode(tmp_path: Path) -> None:
    """Where each array lies: under 4 kB, of an episode of 20 kB or 20 MB; nothing of what is in it."""
    episode = make_episode(np.random.default_rng(0), 5)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    with store.writer() as writer, traced():
        for _ in range(20):
            writer.append(episode)
        before = held()
        for _ in range(50):
            writer.append(episode)
        assert (held() - before) / 50 < 4000


@pytest.mark.slow
def test_collecting_costs_the_same_for_every_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, counter: Counter
) -> None:
    """Calls from one commit to the next: the last ten of 40 episodes need what the first ten needed."""
    calls: list[int] = []
    with counter.counting():
        play(tmp_path, monkeypatch, 40, lambda: calls.append(counter.calls))
    work = np.diff(calls)
    assert len(work) == 39
    assert statistics.median(work[-10:]) <= statistics.median(work[5:15]) * 1.01


@pytest.mark.slow
def test_collecting_keeps_nothing_of_an_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """200 episodes after the first 50 leave less than 50 kB: not even a number and a seed of each."""
    memory: list[int] = []
    with traced():
        play(tmp_path, monkeypatch, 250, lambda: memory.append(held() if len(memory) in {50, 249} else 0))
    assert memory[249] - memory[50] < 50_000


def play(folder: Path, monkeypatch: pytest.MonkeyPatch, episodes: int, note: Callable[[], None]) -> None:
    """Collect in this process, with a note at each commit."""
    commit = job.write_episode

    def noting(*arguments: Any) -> None:
        note()
        commit(*arguments)

    monkeypatch.setattr(job, "write_episode", noting)
    monkeypatch.setattr(job, "play_policy_for", lambda *_: PointPlayPolicy())
    collect(CollectConfig(environment=PointConfig(), episodes=episodes, steps=5), folder / "play", workers=0)


@contextlib.contextmanager
def traced() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
    finally:
        tracemalloc.stop()


def held() -> int:
    """Bytes in use."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]
