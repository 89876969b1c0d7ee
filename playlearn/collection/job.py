"""Record play into a store, episode by episode, on all cores; one that fails does not stop the others."""

import dataclasses
import faulthandler
import json
import shlex
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from playlearn.collection.config import CollectConfig, episode_seed
from playlearn.collection.store import RESOLVED, begin
from playlearn.config import from_dict
from playlearn.episode import Episode
from playlearn.errors import DiskError, PlaylearnError, RenderError, StoreError, UsageError
from playlearn.executor import Job, LocalExecutorConfig, LostError, Result
from playlearn.oracles import play_policy_for
from playlearn.process_cache import cached_env, forget_envs
from playlearn.report.progress import Progress
from playlearn.rollout import rollout
from playlearn.store import write_episode

_OF_ALL = (UsageError, StoreError, DiskError, RenderError, OSError)  # what every other episode would raise too
_GIVE_UP = 10  # failures in a row after which the rest is not tried
_STDERR = 2
_NAMED = 10  # failures in the last message; all were printed when they happened


def collect(config: CollectConfig, out: Path, *, workers: int | None = None, resume: bool = False) -> None:
    """Record episodes 0 ... episodes-1 into the store at `out`; with `resume`, those that are missing.

    The same seed gives the same episodes, whatever the number of workers and interruptions. An episode
    that fails is reported, and the others are still played.

    Raises:
        UsageError: `out` was begun with another config; an unknown camera.
        StoreError: `out` holds something already and `resume` was not asked for.
        BusyError: another process writes there.
        DiskError: the disk is full.
        PlaylearnError: episodes failed; gives the command that plays each of them by itself.
    """
    environment = cached_env(config.environment)
    play_policy_for(environment, config.play)  # an unknown kind of skill fails now, not in a worker
    store = begin(config, environment, out, resume=resume)
    with store.writer():
        done = set(store.indices().tolist())
        settings = json.dumps(config.settings())
        jobs = [
            Job(
                key=index,
                function=record,
                kwargs={"settings": settings, "folder": str(out), "index": index},
                seed=episode_seed(config.seed, index),
            )
            for index in range(config.episodes)
            if index not in done
        ]
        executor = LocalExecutorConfig(workers=workers, timeout=config.limit())
        failed, untried = _run(jobs, f"collect {out}", config.episodes, environment.spec.fps, executor)
    if failed:
        raise PlaylearnError(_failure_message(failed, untried, config, out))


def record(settings: str, folder: str, index: int) -> tuple[int, str]:
    """Play one episode and put it into the store: one job. Returns steps and why it ended."""
    try:
        episode = play(from_dict(CollectConfig, json.loads(settings)), index)
    except Exception:
        forget_envs()  # the next episode starts in a fresh environment
        raise
    write_episode(folder, index, episode)
    return len(episode), episode.meta.ended


def play(config: CollectConfig, index: int) -> Episode:
    """Episode `index` of a collection: a pure function of its arguments.

    Raises:
        PlaylearnError: the environment failed before the first action.
    """
    environment = cached_env(config.environment)
    seed = episode_seed(config.seed, index)
    environment.reset(seed)
    policy = play_policy_for(environment, config.play)
    outcome = rollout([environment], policy, [None], seeds=[seed], max_steps=config.steps, cameras=config.cameras)[0]
    if outcome.episode is None:
        raise PlaylearnError(f"it ended before its first action: {outcome.ended}")
    return outcome.episode


def collect_one(config: CollectConfig, out: Path, index: int) -> None:
    """Play only episode `index`, in this process; what it raises comes through, with its traceback.

    A fresh `out` becomes a store of this one episode. A store that lacks it gets it. A store that has it is left as it
    is, and the two are compared bit for bit: on the machine that played it they are the same.

    Raises:
        PlaylearnError: played again it is not the episode that the store holds.
    """
    store = begin(config, cached_env(config.environment), out, resume=(out / "store.json").exists())
    with store.writer() as writer:
        with _tracebacks(config.limit()):
            episode = play(config, index)
        what = f"episode {index} (seed {episode.meta.seed}): {len(episode)} steps, ended: {episode.meta.ended}"
        held = np.flatnonzero(store.indices() == index)
        if len(held) == 0:
            writer.append(episode, index)
            print(f"{what}; it is in {out}", file=sys.stderr)
            return
        different = _differences(episode, store.read(int(held[0])))
        if different:
            raise PlaylearnError(f"{what}; it is not the one in {out}: {', '.join(different)} differ")
        print(f"{what}; the one in {out} is the same, bit for bit", file=sys.stderr)


def _run(
    jobs: Sequence[Job], title: str, total: int, fps: float, config: LocalExecutorConfig
) -> tuple[list[Result], int]:
    """What failed, and how many were not tried after it."""
    steps, seconds, in_a_row = 0, time.perf_counter(), 0
    ended: dict[str, int] = {}
    failed: list[Result] = []
    seeds = {job.key: job.seed for job in jobs}
    with config.build() as executor, Progress(title, total, "episode", total - len(jobs), executor.workers) as progress:
        for count, result in enumerate(executor.run(jobs, keep_going=True), 1):
            name = f"episode {result.key} (seed {seeds[result.key]})"
            if isinstance(result.error, _OF_ALL):
                raise result.error
            if result.error is not None:
                failed.append(result)
                progress.say(f"{name} failed: {_reason(result)}")
            else:
                steps += result.value[0]
                why = result.value[1].partition(":")[0]
                ended[why] = ended.get(why, 0) + 1
                if result.tries > 1:
                    progress.say(f"{name} was played again: a worker died or hung, {result.tries - 1} times")
            in_a_row = in_a_row + 1 if result.error is not None else 0
            progress.to(total - len(jobs) + count, seconds=result.seconds)
            if in_a_row >= _GIVE_UP:
                break
    made, seconds = sum(ended.values()), time.perf_counter() - seconds
    if made:
        odd = ", ".join(f"{count} x {why}" for why, count in sorted(ended.items()) if why != "length")
        print(
            f"{made} episodes, {steps} steps ({steps / fps:.0f} s of play) in {seconds:.0f} s: "
            f"{steps / seconds:.0f} steps/s{'; ended early: ' + odd if odd else ''}",
            file=sys.stderr,
        )
    return failed, len(jobs) - made - len(failed)


def _failure_message(failed: Sequence[Result], untried: int, config: CollectConfig, out: Path) -> str:
    """What failed, and the command that plays each of them by itself."""
    lines = [f"{len(failed)} episodes failed; all others are safe, and --resume tries these again"]
    if untried:
        lines[0] = (
            f"{_GIVE_UP} episodes failed in a row: given up; {untried} others were not tried, what is done is safe"
        )
    command = f"playlearn collect --config {shlex.quote(str(out / RESOLVED))} --out {shlex.quote(str(out))}"
    for result in failed[:_NAMED]:
        lines.append(f"episode {result.key} (seed {episode_seed(config.seed, result.key)}): {_reason(result)}")
        lines.append(f"  by itself, with a traceback: {command} --seed {config.seed} --episode {result.key}")
    if len(failed) > _NAMED:
        lines.append(f"and {len(failed) - _NAMED} more")
    return "\n".join(lines)


def _reason(result: Result) -> str:
    """Why an episode failed, in one line."""
    error = result.error
    if isinstance(error, LostError):
        return error.why
    text = " ".join(str(error).split())
    return text if isinstance(error, PlaylearnError) else f"{type(error).__name__}: {text}"


def _differences(one: Episode, other: Episode) -> list[str]:
    """The names of what two episodes do not have in common."""
    mine, its = one.arrays(), other.arrays()
    names = [
        name
        for name in sorted(mine.keys() | its.keys())
        if name not in mine or name not in its or not np.array_equal(mine[name], its[name])
    ]
    return names + [
        f"meta.{entry.name}"
        for entry in dataclasses.fields(one.meta)
        if getattr(one.meta, entry.name) != getattr(other.meta, entry.name)
    ]


@contextmanager
def _tracebacks(limit: float | None) -> Iterator[None]:
    """Show where it fails, crashes or hangs; after `limit` seconds print the traceback and end the process."""
    faulthandler.enable(file=_STDERR)
    if limit is not None:
        faulthandler.dump_traceback_later(limit, exit=True, file=_STDERR)
    try:
        yield
    except PlaylearnError:
        traceback.print_exc()  # any other error keeps its own
        raise
    finally:
        faulthandler.cancel_dump_traceback_later()
