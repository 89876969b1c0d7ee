"""One round of practice: the policy tries, the expert labels and finishes, what got to its goal is kept."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from playlearn.collect.world import kind, world
from playlearn.config import atomic_write
from playlearn.dagger.actor import Mixed, Sharing
from playlearn.episode import Observation
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluate import Setup, SuiteConfig, Trained
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.report.progress import Progress
from playlearn.rollout import STOPPED, Actor, Outcome, rollout
from playlearn.sim import Environment
from playlearn.store import NativeStore, StoreSpec, write_episode

Make = Callable[[Environment], Actor]


@dataclass(frozen=True)
class Practice:
    """What a worker needs to know. seed: of starts and goals. sharing: without `plans`, which the policy decides.

    record: whether what the policy sees is kept.
    """

    suite: SuiteConfig
    policy: Trained
    expert: Make
    sharing: Sharing
    seed: int
    finish_steps: int
    settle: int
    record: bool = True

    @property
    def recorded(self) -> tuple[str, ...]:
        """The cameras whose images are kept."""
        return self.policy.cameras() if self.record else ()


@dataclass(frozen=True)
class Tried:
    """One episode. kept: it ended in its goal. labels: states that the expert was asked about. driven: steps that
    it acted in. alone: the policy got there without it.
    """

    episode: int
    task: str
    kept: bool
    ended: str
    labels: int = 0
    driven: int = 0
    alone: bool = False


def practise(practice: Practice, numbers: Sequence[int], out: Path, workers: int | None, title: str) -> list[Tried]:
    """Try these episodes, leave those that got to their goals in the store `out`/play; a broken call goes on.

    Raises:
        UsageError: the suite is not one of a world that this policy and this expert know.
    """
    store, notes = out / "play", out / "practice"
    make_store(practice.suite, practice.recorded, store)
    notes.mkdir(parents=True, exist_ok=True)
    size = practice.suite.cohort
    cohorts = [tuple(numbers[i : i + size]) for i in range(0, len(numbers), size)]
    jobs = [
        Job(cohort[0], attempt, {"practice": practice, "numbers": cohort, "store": store, "note": _note(notes, cohort)})
        for cohort in cohorts
        if not _note(notes, cohort).exists()
    ]
    done = len(numbers) - sum(len(job.kwargs["numbers"]) for job in jobs)
    with (
        NativeStore.open(store).writer(),
        LocalExecutorConfig(workers=workers).build() as executor,
        Progress(title, len(numbers), "episode", done, executor.workers) as progress,
    ):
        for result in executor.run(jobs):
            done += result.value
            progress.to(done, seconds=result.seconds)
    rows = [row for cohort in cohorts for row in json.loads(_note(notes, cohort).read_text())]
    return [Tried(**row) for row in rows]


def attempt(practice: Practice, numbers: Sequence[int], store: Path, note: Path) -> int:
    """Try a few episodes together, put what is kept into the store, then write down how each went. Returns how many."""
    first = world(practice.suite.environment)
    expert = practice.expert(first)
    actor = mixed(practice, first)
    setups, tried = _setups(practice, numbers, first, expert)
    worlds = [first, *(first.clone() for _ in setups[1:])][: len(setups)]
    for one, setup in zip(worlds, setups, strict=True):
        one.set_state(setup.start)
    there = [0] * len(setups)

    def settled(k: int, seen: Observation) -> bool:
        there[k] = there[k] + 1 if worlds[k].reached(seen.achieved, setups[k].goal.achieved) else 0
        return there[k] >= practice.settle

    outcomes = rollout(
        worlds,
        actor,
        [setup.goal for setup in setups],
        seeds=[setup.seed for setup in setups],
        max_steps=practice.sharing.steps[1] + practice.finish_steps,
        stop=settled,
        cameras=practice.recorded,
    )
    for setup, outcome in zip(setups, outcomes, strict=True):
        tried.append(_tried(setup, outcome))
        if tried[-1].kept and outcome.episode is not None:
            meta = replace(outcome.episode.meta, task=setup.task)
            write_episode(store, setup.episode, replace(outcome.episode, meta=meta))
    rows = [asdict(row) for row in sorted(tried, key=lambda row: row.episode)]
    atomic_write(note, json.dumps(rows).encode())
    return len(rows)


def mixed(practice: Practice, environment: Environment) -> Mixed:
    """The policy and the expert at one hand, in this environment.

    Raises:
        PlaylearnError: either cannot act there.
    """
    policy = practice.policy.build(environment)
    sharing = replace(practice.sharing, plans=policy.execute)
    return Mixed(policy, practice.expert(environment), sharing, policy.spread)


def make_store(suite: SuiteConfig, cameras: Sequence[str], path: Path) -> None:
    """An empty store for episodes of a suite's world as seen through these cameras, where there is none yet."""
    if (path / "store.json").exists():
        return
    environment = world(suite.environment)
    seen = environment.observe(tuple(cameras)).images
    spec = environment.spec
    NativeStore.create(
        path,
        StoreSpec(
            environment=kind(suite.environment),
            state_names=spec.state_names,
            achieved_names=spec.achieved_names,
            action_names=spec.action_names,
            fps=spec.fps,
            cameras={name: (int(image.shape[0]), int(image.shape[1])) for name, image in seen.items()},
        ),
    )


def _setups(
    practice: Practice, numbers: Sequence[int], environment: Environment, expert: Actor
) -> tuple[list[Setup], list[Tried]]:
    """Starts and goals; and the episodes for which there are none."""
    suite, setups, without = practice.suite, [], []
    for number in numbers:
        try:
            setups.append(
                suite.kind.setup(environment, expert, number, practice.seed, suite.max_steps, practice.policy.cameras())
            )
        except UsageError:
            raise
        except PlaylearnError as error:
            without.append(Tried(number, "", kept=False, ended=f"not set up: {error}"))
    return setups, without


def _tried(setup: Setup, outcome: Outcome) -> Tried:
    episode = outcome.episode
    driven = 0 if episode is None else int(episode.intervention.sum())
    kept = outcome.ended == STOPPED
    alone = kept and driven == 0
    return Tried(setup.episode, setup.task, kept, outcome.ended, outcome.steps, driven, alone)


def _note(folder: Path, cohort: Sequence[int]) -> Path:
    return folder / f"{cohort[0]:06d}.json"
