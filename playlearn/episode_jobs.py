"""One job for each episode of a store, on all cores; each leaves one file, so an interrupted run continues."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from playlearn.executor import Job, LocalExecutorConfig
from playlearn.report.progress import Progress
from playlearn.store import episode_path


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
