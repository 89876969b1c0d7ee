"""One thread a process, in every process there is: what is asserted are the counts in force, not what was asked for."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba  # noqa: F401 - as in a worker that steps an environment
import numpy as np
import pytest
import scipy.linalg
import torch

from playlearn import cli
from playlearn.bench.base import Figure, Size, _in_process
from playlearn.data.prefetch import prepared_ahead
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.threads import environment, in_force, limit

ROOT = Path(__file__).parents[1]
ALL_ONE = {"torch": 1, "torch_interop": 1, "numba": 1, "openblas": 1}
MANY = {**os.environ, **environment(3), "PYTHONPATH": str(ROOT)}


@pytest.fixture
def three() -> Iterator[None]:
    """A process that had three threads; afterwards it has one."""
    limit(3)
    yield
    limit(1)


def report() -> dict[str, int]:
    """What is in force where this runs, with all that is numerical imported above, and used once."""
    scipy.linalg.solve(np.eye(3), np.ones(3))
    return in_force() | {"software_gl": int(os.environ["LP_NUM_THREADS"])}


def figures(_size: Size) -> Iterator[Figure]:
    for name, count in report().items():
        yield Figure(name, count, "threads")


def printed(code: str) -> Any:
    """What a fresh process prints, started where three threads are the custom."""
    done = subprocess.run([sys.executable, "-c", code], env=MANY, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_what_is_imported_already_is_limited_too() -> None:
    """In the main thread and in the one that prepares batches (numba counts by thread). Inter-op is one in any case."""
    code = (
        "import json, numpy, scipy.linalg, numba, torch\n"
        "from playlearn.data.prefetch import prepared_ahead\n"
        "from playlearn.threads import in_force, limit\n"
        "torch.set_num_threads(3)\n"
        "found = [in_force()]\n"
        "for threads in (1, 2):\n"
        "    limit(threads)\n"
        "    batches = prepared_ahead(lambda _: in_force(), 0); there = next(batches); batches.close()\n"
        "    found += [in_force(), there]\n"
        "print(json.dumps(found))\n"
    )
    before, *after = printed(code)
    assert (before["torch"], before["numba"]) == (3, 3)
    for threads, here, there in zip((1, 2), after[::2], after[1::2], strict=True):
        assert here == {"torch": threads, "torch_interop": 1, "numba": threads, "openblas": threads}
        assert {**there, "numba": threads} == here


@pytest.mark.slow
def test_what_a_command_imports_is_limited() -> None:
    """The command's own process, also under a launcher that sets OMP_NUM_THREADS, as `accelerate launch` does."""
    code = (
        "import json\n"
        "from dataclasses import replace\n"
        "from playlearn import cli\n"
        "from playlearn.threads import in_force\n"
        "def command(_):\n"
        "    import numpy, scipy.linalg, numba, torch\n"
        "    print(json.dumps(in_force()))\n"
        "    return 0\n"
        "cli.doctor.VERB = replace(cli.doctor.VERB, run=command)\n"
        "raise SystemExit(cli.main(['doctor']))\n"
    )
    found = printed(code)
    del found["torch_interop"]  # of which no variable speaks: commands that use torch limit it, see below
    assert found == {"torch": 1, "numba": 1, "openblas": 1}


@pytest.mark.parametrize(
    ("job", "command"),
    [
        ("playlearn.evaluation.evaluate", "eval --policy expert --suite s --goal state --out o"),
        ("playlearn.evaluation.diagnosis.diagnose", "diagnose --run r --suite s --goal state --out o"),
        ("playlearn.dagger.dagger", "dagger --config configs/dagger/playtable_state.yaml --run r --out o"),
        ("playlearn.experiments.compare.compare", "compare --config configs/compare/heads_state.yaml --out o"),
        ("playlearn.training.train", "train --config configs/train/playtable_state_diffusion.yaml --out o"),
        ("playlearn.collection.collect", "collect --config configs/collect/playtable.yaml --out o"),
        ("playlearn.collection.render_store", "render s o --camera front=8x8"),
        ("playlearn.bench.run", "bench sim"),
        ("playlearn.experiments.toy.run", "toy --config configs/toy/fork.yaml --out o"),
    ],
)
@pytest.mark.usefixtures("three")
def test_every_job_begins_with_one_thread(job: str, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where torch and BLAS are there already and have three."""
    counts: list[dict[str, int]] = []

    def begun(*_: Any, **__: Any) -> None:
        counts.append({"torch": torch.get_num_threads(), "software_gl": int(os.environ["LP_NUM_THREADS"])})
        raise KeyboardInterrupt  # it has recorded what was asked for

    monkeypatch.setattr(job, begun)
    monkeypatch.chdir(ROOT)
    assert cli.main(command.split()) == 130
    assert counts == [{"torch": 1, "software_gl": 0}]


@pytest.mark.usefixtures("three")
def test_an_experiment_of_the_lab_has_one_thread(tmp_path: Path) -> None:
    from playlearn.experiments.toy.base import Experiment, run

    class Counted(Experiment):
        def measure(self, _say: Any) -> Any:
            raise LookupError(torch.get_num_threads())

    with pytest.raises(LookupError, match="1"):
        run(Counted(), tmp_path / "out", print)


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_every_worker_has_one_thread(workers: int) -> None:
    """Also for the job after one that took more; none but this process: that is one of the workers then."""
    jobs = [Job(0, report), Job(1, limit, {"threads": 2}), Job(2, report)]
    with LocalExecutorConfig(workers=workers).build() as executor:
        results = {result.key: result.value for result in executor.run(jobs)}
    assert results[0] == results[2] == {**ALL_ONE, "software_gl": 0}


@pytest.mark.slow
@pytest.mark.usefixtures("three")
def test_a_benchmarks_process_has_one_thread() -> None:
    limit()  # as `run` does before any
    found = {figure.name: figure.value for figure in _in_process(figures, Size())}
    assert found == {**ALL_ONE, "software_gl": 0}


def test_the_thread_that_prepares_batches_has_as_many_as_its_process() -> None:
    limit(2)
    batches = prepared_ahead(lambda _: torch.get_num_threads(), 0)
    try:
        assert next(batches) == 2
    finally:
        batches.close()  # type: ignore[attr-defined]
        limit(1)
