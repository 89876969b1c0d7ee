"""What the tests of kills run in a process of its own: `python kills.py SCENARIO FOLDER`.

It forks, because a kill must end a process and 200 fresh ones would take minutes. A scenario prints
one JSON line; what goes wrong is an AssertionError.
"""

import contextlib
import functools
import io
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
from tqdm import tqdm

import playlearn
from playlearn.store import NativeStore, StoreSpec, write_episode
from tests.synthetic import make_episode

PACKAGE = Path(playlearn.__file__).parent
COMMIT = ("store/native.py", "store/tensors.py", "store/folder.py", "config/record.py")
COLLECT = ("store/native.py", "store/folder.py", "collection/job.py", "collection/store.py")

tqdm.monitor_interval = 0  # no thread of its own: one that forks should have none


def forked(act: Callable[[], object]) -> int:
    """Let a copy of this process do it; the signal that ended the copy, 0 if it came through."""
    child = os.fork()
    if child == 0:
        try:
            act()
        except BaseException:  # noqa: BLE001 - whatever it is, only its code may leave
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, status
    return os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0


def traced(files: tuple[str, ...], act: Callable[[], object], line: Callable[[CodeType, int], object]) -> None:
    """`act`, with `line(code, number)` called before every line of those files of the package."""
    wanted = {str(PACKAGE / name) for name in files}

    def local(frame: FrameType, event: str, _arg: Any) -> Any:
        if event == "line":
            line(frame.f_code, frame.f_lineno)
        return local

    def entered(frame: FrameType, _event: str, _arg: Any) -> Any:
        return local if frame.f_code.co_filename in wanted else None

    sys.settrace(entered)
    try:
        act()
    finally:
        sys.settrace(None)


def lines(files: tuple[str, ...], act: Callable[[], object]) -> list[str]:
    """The lines of those files that `act` runs, in order, `file:number`."""
    passed: list[str] = []
    traced(files, act, lambda code, number: passed.append(f"{Path(code.co_filename).name}:{number}"))
    return passed


def killed_before(files: tuple[str, ...], act: Callable[[], object], nth: int) -> None:
    """`act` in a copy of this process that is killed before the nth of those lines."""
    left = nth

    def count(_code: CodeType, _number: int) -> None:
        nonlocal left
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left -= 1

    assert forked(lambda: traced(files, act, count)) == signal.SIGKILL


def every_line_of_a_commit(folder: Path) -> dict[str, Any]:
    """Killed before each line that an append runs; each time the store is whole, and the append can be done again."""
    store, episode, reference = _prepared(folder)
    points = lines(COMMIT, lambda: write_episode(folder / "other", 1, episode))
    committed = 0
    for nth in range(len(points)):
        killed_before(COMMIT, lambda: write_episode(folder / "play", 1, episode), nth)
        committed += _mended(store, episode, reference, points[nth])
    return {"kills": len(points), "committed": committed, "points": sorted(set(points))}


def half_written(folder: Path) -> dict[str, Any]:
    """Killed by the kernel in the middle of the write, after so many bytes."""
    store, episode, reference = _prepared(folder)
    sizes = [0, 1, 4096, len(reference) // 2, len(reference) - 1]
    left: list[int] = []
    for size in sizes:

        def act(size: int = size) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
            write_episode(folder / "play", 1, episode)

        assert forked(act) == signal.SIGXFSZ
        left += [path.stat().st_size for path in (folder / "play" / "episodes").glob(".*.tmp")]
        assert _mended(store, episode, reference, f"{size} bytes") == 0
    return {"kills": len(sizes), "sizes": sizes, "left": left}


def every_line_of_a_collection(folder: Path) -> dict[str, Any]:
    """Killed once before each line of collection and store, the first or another time it is run; then resumed."""
    from playlearn.collection import store as module
    from tests.faults import point

    point.install()
    config, out = point.config(episodes=2, steps=4), folder / "play"
    module.git_revision = lambda: "abc"  # type: ignore[assignment]  # quick, and the same in every round
    module.versions = dict  # type: ignore[assignment]

    def act() -> None:
        _collect(config, out)

    act()  # the environment is built now, not only in the first round
    shutil.rmtree(out)
    points = lines(COLLECT, act)
    reference = contents(out)
    often = {where: [nth for nth, passed in enumerate(points) if passed == where] for where in points}
    rng = np.random.default_rng(0)
    chosen = [int(rng.choice(times)) for times in often.values()]
    for nth in chosen:
        shutil.rmtree(out)
        killed_before(COLLECT, act, nth)
        if (out / "store.json").exists():
            store = NativeStore.open(out)
            assert store.verify() == [], points[nth]
            assert (out / "collect.json").read_bytes() == reference["collect.json"], points[nth]
        act()
        assert contents(out) == reference, points[nth]
    return {"kills": len(chosen), "lines": len(points)}


def random_moments(folder: Path) -> dict[str, Any]:
    """Ended by the kernel at any moment, again and again, until it is done in spite of it.

    Each try begins 2 to 11 episodes and is ended within the time of about two more: on a machine however slow it
    commits one at the least, so that there are at most as many kills as episodes.
    """
    from tests.faults import point

    point.install()
    config, out = point.config(episodes=80, steps=10), folder / "play"
    _collect(config, folder / "whole")
    rng, grew = np.random.default_rng(0), [0]
    while True:
        begun, fraction = int(rng.integers(2, 12)), rng.uniform(0, 2)
        if forked(functools.partial(_struck, config, out, begun, fraction)) == 0:
            break
        store = NativeStore.open(out)
        assert store.verify() == []
        grew.append(len(store))
        assert grew[-1] > grew[-2], "what was committed stays, and there is more of it"
    assert contents(out) == contents(folder / "whole")
    return {"kills": len(grew) - 1}


def _struck(config: Any, out: Path, begun: int, fraction: float) -> None:
    """Collect, until that fraction of an episode's time after so many of them have begun an alarm ends this process."""
    from tests.faults import point

    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # so that it ends at once, wherever it is
    reset, moments = point.FaultyPlayPolicy.reset, [time.monotonic()]

    def counted(policy: point.FaultyPlayPolicy, *given: Any) -> None:
        moments.append(time.monotonic())
        if len(moments) == begun + 1:
            signal.setitimer(signal.ITIMER_REAL, max(1e-6, fraction * (moments[-1] - moments[-2])))
        reset(policy, *given)

    point.FaultyPlayPolicy.reset = counted  # type: ignore[method-assign]  # only in this copy of the process
    _collect(config, out)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file but the lock, by name."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def _prepared(folder: Path) -> tuple[NativeStore, Any, bytes]:
    """A store of one episode at `folder / "play"`, another episode, and the bytes that its file has to have."""
    rng = np.random.default_rng(0)
    first, episode = make_episode(rng, 20, ("front",), seed=0), make_episode(rng, 20, ("front",), seed=1)
    for name in ("play", "other"):
        store = NativeStore.create(folder / name, StoreSpec.of(first))
        with store.writer() as writer:
            writer.append(first, 0)
    reference = write_episode(folder / "other", 1, episode).read_bytes()
    return NativeStore.open(folder / "play"), episode, reference


def _mended(store: NativeStore, episode: Any, reference: bytes, where: str) -> int:
    """Check what a kill left, append what is missing, and take it away again. 1 if it had been committed."""
    seen = NativeStore.open(store.path)
    assert seen.verify() == [], where
    there = 1 in seen.indices()
    with seen.writer() as writer:
        if not there:
            writer.append(episode, 1)
    left = sorted(path.name for path in (store.path / "episodes").iterdir())
    assert left == ["000000.safetensors", "000001.safetensors"], where
    path = store.path / "episodes" / left[1]
    assert path.read_bytes() == reference, where
    path.unlink()
    return int(there)


def _collect(config: Any, out: Path) -> None:
    from playlearn.collection import collect

    with contextlib.redirect_stderr(io.StringIO()):
        collect(config, out, workers=0, resume=True)


if __name__ == "__main__":
    scenarios = (every_line_of_a_commit, half_written, every_line_of_a_collection, random_moments)
    chosen = {scenario.__name__: scenario for scenario in scenarios}[sys.argv[1]]
    print(json.dumps(chosen(Path(sys.argv[2]))))
