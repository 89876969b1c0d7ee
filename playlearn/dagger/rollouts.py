"""One round of practice: the policy tries, the expert labels and finishes, what got to its goal is kept."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from playlearn.collection.store import store_spec
from playlearn.config import atomic_write
from playlearn.dagger.actor import DaggerActor, InterventionRule
from playlearn.episode import Observation
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation import EvalEpisode, SuiteConfig, TrainedRecipe
from playlearn.executor import Job, LocalExecutorConfig
from playlearn.process_cache import cached_env, cached_envs
from playlearn.report.progress import Progress
from playlearn.rollout import STOPPED, Actor, Outcome, rollout
from playlearn.sim import Environment
from playlearn.store import NativeStore, write_episode

Make = Callable[[Environment], Actor]


@dataclass(frozen=True)
class RolloutSpec:
    """What a worker needs to know. seed: of starts and goals. sharing: without `plans`, which the policy decides.

    record: whether what the policy sees is kept.
    """

    suite: SuiteConfig
    policy: TrainedRecipe
    expert: Make
    rule: InterventionRule
    seed: int
    finish_steps: int
    success_hold_steps: int
    record: bool = True

    @property
    def recorded(self) -> tuple[str, ...]:
        """The cameras whose images are kept."""
        return self.policy.cameras() if self.record else ()


@dataclass(frozen=True)
class RolloutRecord:
    """One episode. kept: it ended in its goal. labels: states that the expert was asked about. driven: steps that
    it acted in. alone: the policy got there without it.
    """

    episode: int
    task: str
    kept: bool
    ended: str
    labels: int = 0
    expert_steps: int = 0
    solved_without_expert: bool = False


def collect_rollouts(
    spec: RolloutSpec, numbers: Sequence[int], out: Path, workers: int | None, title: str
) -> list[RolloutRecord]:
    """Try these episodes, leave those that got to their goals in the store `out`/play; a broken call goes on.

    Raises:
        UsageError: the suite is not one of a world that this policy and this expert know.
    """
    store, notes = out / "play", out / "rollouts"
    make_store(spec.suite, spec.recorded, store)
    notes.mkdir(parents=True, exist_ok=True)
    size = spec.suite.num_envs
    batches = [tuple(numbers[i : i + size]) for i in range(0, len(numbers), size)]
    jobs = [
        Job(batch[0], attempt, {"spec": spec, "numbers": batch, "store": store, "note": _note(notes, batch)})
        for batch in batches
        if not _note(notes, batch).exists()
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
    rows = [row for batch in batches for row in json.loads(_note(notes, batch).read_text())]
    return [RolloutRecord(**row) for row in rows]


def attempt(spec: RolloutSpec, numbers: Sequence[int], store: Path, note: Path) -> int:
    """Try a few episodes together, put what is kept into the store, then write down how each went. Returns how many."""
    envs = cached_envs(spec.suite.environment, len(numbers))
    first = envs[0]
    expert = spec.expert(first)
    actor = dagger_actor(spec, first)
    setups, records = _setups(spec, numbers, first, expert)
    envs = envs[: len(setups)]
    for one, setup in zip(envs, setups, strict=True):
        one.set_state(setup.start)
    there = [0] * len(setups)

    def settled(k: int, seen: Observation) -> bool:
        there[k] = there[k] + 1 if envs[k].reached(seen.achieved, setups[k].goal.achieved) else 0
        return there[k] >= spec.success_hold_steps

    outcomes = rollout(
        envs,
        actor,
        [setup.goal for setup in setups],
        seeds=[setup.seed for setup in setups],
        max_steps=spec.rule.steps[1] + spec.finish_steps,
        stop=settled,
        cameras=spec.recorded,
    )
    for setup, outcome in zip(setups, outcomes, strict=True):
        records.append(_record(setup, outcome))
        if records[-1].kept and outcome.episode is not None:
            meta = replace(outcome.episode.meta, task=setup.task)
            write_episode(store, setup.episode, replace(outcome.episode, meta=meta))
    rows = [asdict(row) for row in sorted(records, key=lambda row: row.episode)]
    atomic_write(note, json.dumps(rows).encode())
    return len(rows)


def dagger_actor(spec: RolloutSpec, environment: Environment) -> DaggerActor:
    """The policy and the expert at one hand, in this environment.

    Raises:
        PlaylearnError: either cannot act there.
    """
    policy = spec.policy.build(environment)
    rule = replace(spec.rule, plans=policy.n_action_steps)
    return DaggerActor(policy, spec.expert(environment), rule, policy.std)


def make_store(suite: SuiteConfig, cameras: Sequence[str], path: Path) -> None:
    """An empty store for episodes of a suite's world as seen through these cameras, where there is none yet."""
    if (path / "store.json").exists():
        return
    NativeStore.create(path, store_spec(cached_env(suite.environment), cameras))


def _setups(
    spec: RolloutSpec, numbers: Sequence[int], environment: Environment, expert: Actor
) -> tuple[list[EvalEpisode], list[RolloutRecord]]:
    """Starts and goals; and the episodes for which there are none."""
    suite, setups, without = spec.suite, [], []
    for number in numbers:
        try:
            setups.append(
                suite.kind.setup(environment, expert, number, spec.seed, suite.max_steps, spec.policy.cameras())
            )
        except UsageError:
            raise
        except PlaylearnError as error:
            without.append(RolloutRecord(number, "", kept=False, ended=f"not set up: {error}"))
    return setups, without


def _record(setup: EvalEpisode, outcome: Outcome) -> RolloutRecord:
    episode = outcome.episode
    expert_steps = 0 if episode is None else int(episode.intervention.sum())
    kept = outcome.ended == STOPPED
    solved_without_expert = kept and expert_steps == 0
    return RolloutRecord(
        setup.episode, setup.task, kept, outcome.ended, outcome.steps, expert_steps, solved_without_expert
    )


def _note(folder: Path, batch: Sequence[int]) -> Path:
    return folder / f"{batch[0]:06d}.json"
