"""Laws of the executor: every job exactly once, whatever happens to the workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from playlearn.errors import UsageError
from playlearn.executor import Job, LocalExecutorConfig, LostError, worker
from playlearn.executor import local as local_executor
from playlearn.threads import environment

SLOW_TO_IMPORT = "PLAYLEARN_TEST_SECONDS_TO_IMPORT"
time.sleep(float(os.environ.get(SLOW_TO_IMPORT, "0")))


def draw(seed: int) -> float:
    import numpy as np

    return float(np.random.default_rng(seed).standard_normal())


def process_and_threads() -> tuple[int, dict[str, str | None]]:
    return os.getpid(), {name: os.environ.get(name) for name in environment()}


def blocked_signals() -> set[int]:
    return set(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, ())))


def die_until(marks: str, times: int) -> int:
    """Kill this process the first `times` times; then return how often it was tried."""
    tries = len(list(Path(marks).iterdir()))
    if tries < times:
        (Path(marks) / str(tries)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return tries


def leave(code: int) -> None:
    os._exit(code)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def sleep(seconds: float) -> str:
    time.sleep(seconds)
    return "slept"


def complain() -> None:
    raise UsageError("no such store; make one with: playlearn collect")


class OddError(Exception):
    """Cannot be built again from its arguments."""

    def __init__(self, left: str, right: str) -> None:
        super().__init__(left + right)


def complain_oddly() -> None:
    raise OddError("left", "right")


def local(workers: int, **options: float) -> LocalExecutorConfig:
    return LocalExecutorConfig(workers=workers, **options)  # type: ignore[arg-type]


@pytest.mark.slow
def test_results_are_the_same_for_any_number_of_workers() -> None:
    """A job is a pure function of its seed, so 0, 1 and 3 workers give the same values."""
    jobs = [Job(key=seed, function=draw, kwargs={"seed": seed}, seed=seed) for seed in range(7)]
    runs = []
    for workers in (0, 1, 3):
        results = list(local(workers).build().run(jobs))
        assert sorted(result.key for result in results) == list(range(7)), "each job exactly once"
        runs.append({result.key: result.value for result in results})
    assert runs[0] == runs[1] == runs[2]


def test_workers_live_on_and_are_single_threaded() -> None:
    """Two jobs on one worker share its process, which is not this one and computes on one thread."""
    jobs = [Job(key=k, function=process_and_threads) for k in range(2)]
    (first, threads), (second, _) = (result.value for result in local(1).build().run(jobs))
    assert first == second != os.getpid()
    assert threads == environment(1)


def test_in_a_with_block_workers_live_on_between_runs() -> None:
    """The second run finds the first one's process, and no process is left when the block ends."""
    with local(1).build() as executor:
        first, second = (next(executor.run([Job(0, process_and_threads)])).value[0] for _ in range(2))
        assert first == second
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


def test_starting_workers_leaves_the_environment_as_it_was() -> None:
    before = dict(os.environ)
    list(local(1).build().run([Job(key=0, function=draw, kwargs={"seed": 0})]))
    assert dict(os.environ) == before


@pytest.mark.slow
def test_a_lost_workers_job_runs_again(tmp_path: Path) -> None:
    """Killed twice, the third and last try gives the value; it is counted once."""
    results = list(local(1).build().run([Job(0, die_until, {"marks": str(tmp_path), "times": 2})]))
    assert [(result.value, result.tries) for result in results] == [(2, 3)]


@pytest.mark.slow
def test_a_job_lost_too_often_is_named(tmp_path: Path) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    job = Job("batch 4", die_until, {"marks": str(marks), "times": 9}, seed=77)
    with pytest.raises(LostError, match=r"batch 4 \(seed 77\).*3 times.*SIGKILL"):
        list(local(2).build().run([job]))
    assert len(list(marks.iterdir())) == 3, "the first try and two more"


@pytest.mark.parametrize(
    ("job", "how"), [(Job(0, leave, {"code": 3}), "exit code 3"), (Job(0, crash), "SIGSEGV")], ids=["exit", "crash"]
)
def test_how_a_worker_ended_is_reported(job: Job, how: str, capfd: pytest.CaptureFixture[str]) -> None:
    """What crashes in compiled code also says where: its Python stack."""
    with pytest.raises(LostError, match=how) as raised:
        list(local(1, retries=0).build().run([job]))
    assert how in raised.value.why
    assert ("in crash" in capfd.readouterr().err) == (how == "SIGSEGV")


@pytest.mark.slow
def test_keep_going_yields_the_lost_one_and_finishes_the_others(tmp_path: Path) -> None:
    jobs = [Job("bad", die_until, {"marks": str(tmp_path), "times": 9})]
    jobs += [Job(seed, draw, {"seed": seed}) for seed in range(2)]
    results = {result.key: result for result in local(1).build().run(jobs, keep_going=True)}
    assert isinstance(results["bad"].error, LostError)
    assert [results[seed].value for seed in range(2)] == [draw(0), draw(1)]


@pytest.mark.slow
def test_a_hung_worker_is_stopped() -> None:
    started = time.perf_counter()
    hung = local(1, timeout=1.5, retries=0).build()
    with pytest.raises(LostError, match=r"did not finish within 1.5 s"):
        list(hung.run([Job("slow", sleep, {"seconds": 600})]))
    assert time.perf_counter() - started < 300, "long before it would have been done"


@pytest.mark.slow
def test_the_time_a_worker_needs_to_start_is_not_the_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit below what a process takes to start and import, here 4 s, stops no job that is quick."""
    monkeypatch.setenv(SLOW_TO_IMPORT, "4")
    (result,) = local(1, timeout=2, retries=0).build().run([Job(0, process_and_threads)])
    assert result.seconds < 2
    monkeypatch.setattr(worker, "START", 0.0)
    with pytest.raises(LostError, match=r"did not finish within 2 s"):
        list(local(1, timeout=2, retries=0).build().run([Job(0, process_and_threads)]))


@pytest.mark.parametrize("workers", [0, 1])
def test_what_a_job_raises_arrives_unchanged_and_is_not_tried_again(workers: int) -> None:
    with pytest.raises(UsageError, match="no such store"):
        list(local(workers).build().run([Job(0, complain)]))


def test_an_error_that_cannot_travel_is_quoted() -> None:
    with pytest.raises(RuntimeError, match="OddError: leftright"):
        list(local(1).build().run([Job(0, complain_oddly)]))


def test_a_caller_that_stops_listening_leaves_no_process_behind() -> None:
    jobs = [Job(0, process_and_threads), Job(1, sleep, {"seconds": 600})]
    results = local(2).build().run(jobs)
    first = next(results)
    results.close()  # type: ignore[attr-defined]
    with pytest.raises(ProcessLookupError):
        os.kill(first.value[0], 0)


def alive(process: int) -> bool:
    """Whether it still runs; one that has ended stays listed until its exit code is read."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def busy(tmp_path: Path) -> tuple["subprocess.Popen[bytes]", list[int]]:
    """A process whose two workers are in the middle of something, and theirs."""
    script = tmp_path / "job.py"
    script.write_text(
        "import os, sys, time\n"
        "from playlearn.executor import Job, LocalExecutorConfig\n"
        "def wait(path):\n"
        "    open(path + str(os.getpid()), 'w').close()\n"
        "    time.sleep(3600)\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        jobs = [Job(k, wait, {'path': sys.argv[1]}) for k in range(2)]\n"
        "        list(LocalExecutorConfig(workers=2).build().run(jobs))\n"
        "    except KeyboardInterrupt:\n"
        "        sys.exit(130)\n"
    )
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "child-")],
        start_new_session=True,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )
    children: list[int] = []
    while len(children) < 2 and process.poll() is None:
        time.sleep(0.05)
        children = [int(path.name.removeprefix("child-")) for path in tmp_path.glob("child-*")]
    assert len(children) == 2
    return process, children


@pytest.mark.slow
def test_a_killed_parent_leaves_no_worker_behind(tmp_path: Path) -> None:
    """They would sleep for an hour; at once they are gone, before anybody else takes their place."""
    process, children = busy(tmp_path)
    process.kill()
    process.communicate(timeout=600)
    until = time.monotonic() + 120
    while any(map(alive, children)) and time.monotonic() < until:
        time.sleep(0.02)
    assert not any(map(alive, children))


def test_ctrl_c_stops_parent_and_children(tmp_path: Path) -> None:
    """SIGINT to the whole process group, as a terminal sends it: one KeyboardInterrupt, no orphan, no noise."""
    process, children = busy(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130
    assert errors == b""
    for child in children:
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)


def test_ctrl_c_cannot_strike_a_worker_that_is_still_starting(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """SIGINT in a worker's first moment, before any code of ours runs there: it works on and says nothing."""

    class Struck(worker.Worker):
        def __init__(self) -> None:
            super().__init__()
            assert self.process.pid is not None
            os.kill(self.process.pid, signal.SIGINT)

    monkeypatch.setattr(local_executor, "Worker", Struck)
    (result,) = local(1).build().run([Job(0, blocked_signals)])
    assert (result.value, result.tries) == (set(), 1)
    assert capfd.readouterr().err == ""
    assert blocked_signals() == set()


def test_mistakes_are_found_early() -> None:
    with pytest.raises(ValueError, match="module level"):
        Job(0, lambda: None)
    with pytest.raises(UsageError, match="workers is -1"):
        local(-1).build()
