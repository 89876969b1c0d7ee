"""One job for each episode of a store, on all cores; each leaves one file, so an interrupted run continues."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from playlearn.config import held
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.report.progress import Progress
from playlearn.store import Store, episode_path
from playlearn.store.folder import claim, claimed


def make_files(
    folder: Path,
    what: str,
    note: Mapping[str, Any],
    jobs: Sequence[Job],
    workers: int | None,
    check: Callable[[], None] = lambda: None,
) -> None:
    """Leave in `folder` a file for each job, keyed by episode number; those that are there already stay.

    A folder in which nothing is missing is only read, so that several runs may use it at once.

    what: what the files are; `folder`/WHAT.json records what they are made with.
    note: see `claim`.
    check: called before the first job; raises what would go wrong later.

    Raises:
        UsageError: `folder` was made with other settings, or of other episodes.
        BusyError: another process makes them.
        DiskError: the disk is full.
    """
    record = f"{what}.json"
    if claimed(folder, record, note, what) and not missing(jobs, folder):
        return
    with held(folder):
        claim(folder, record, note, what)
        left = missing(jobs, folder)
        check()
        run_jobs(f"{what} {folder}", left, len(jobs), workers)


def made_of(store: Store) -> dict[str, Any]:
    """What of a store determines files that are made of its episodes, for a note."""
    parts = store.digests()
    return {"store": dict(store.spec.environment), "episodes": {k: v for k, v in parts.items() if k != "spec"}}


def missing(jobs: Iterable[Job], folder: Path) -> list[Job]:
    """The jobs, keyed by episode number, whose file is not in `folder` yet."""
    return [job for job in jobs if not episode_path(folder, job.key).exists()]


def run_jobs(title: str, jobs: Sequence[Job], total: int, workers: int | None) -> None:
    """Run the jobs that are left of `total`, with a progress bar; raises what a job raises."""
    if not jobs:
        return
    done = total - len(jobs)
    with (
        LocalExecutorConfig(workers=workers).build() as executor,
        Progress(title, total, "episode", done, executor.workers) as progress,
    ):
        for count, result in enumerate(executor.run(jobs), done + 1):
            progress.to(count, seconds=result.seconds)
