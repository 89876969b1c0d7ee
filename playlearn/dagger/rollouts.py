"""One round of rollouts: the policy acts, the expert labels and finishes; episodes that reach their goals are kept."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from playlearn.collection.store import store_spec
from playlearn.config import atomic_write, make_folder
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
    """How rollouts are made.

    suite: of starts and goals.
    policy: what acts.
    expert: builds the expert of an environment.
    rule: who acts when; its `plans` is set from the policy.
    seed: of starts and goals.
    finish_steps: steps that the expert has to reach the goal once it has taken over.
    success_hold_steps: steps for which the goal must be reached before an episode ends.
    record: whether the images that the policy sees are kept.
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
    """One episode.

    episode: its number.
    task: name of the task.
    kept: whether it ended in its goal.
    ended: how it ended.
    labels: states that the expert labeled.
    expert_steps: steps in which the expert acted.
    solved_without_expert: the policy reached the goal by itself.
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
    """Attempt these episodes; keep those that reach their goals in the store `out`/play; continues an interrupted call.

    Raises:
        UsageError: policy or expert cannot act in the suite's environment.
    """
    store, notes = out / "play", out / "rollouts"
    make_store(spec.suite, spec.recorded, store)
    make_folder(notes)
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
    """Attempt a few episodes in one batch: one job. Stores what is kept, then how each went; returns how many."""
    envs = cached_envs(spec.suite.environment, len(numbers))
    first = envs[0]
    expert = spec.expert(first)
    actor = dagger_actor(spec, first)
    episodes, records = _set_up(spec, numbers, first, expert)
    envs = envs[: len(episodes)]
    for env, episode in zip(envs, episodes, strict=True):
        env.set_state(episode.start_sim_state)
    held = [0] * len(episodes)

    def held_long_enough(k: int, seen: Observation) -> bool:
        held[k] = held[k] + 1 if envs[k].reached(seen.achieved, episodes[k].goal.achieved) else 0
        return held[k] >= spec.success_hold_steps

    outcomes = rollout(
        envs,
        actor,
        [episode.goal for episode in episodes],
        seeds=[episode.seed for episode in episodes],
        max_steps=spec.rule.steps[1] + spec.finish_steps,
        stop=held_long_enough,
        cameras=spec.recorded,
    )
    for episode, outcome in zip(episodes, outcomes, strict=True):
        records.append(_record(episode, outcome))
        if records[-1].kept and outcome.episode is not None:
            meta = replace(outcome.episode.meta, task=episode.task, success=True)
            write_episode(store, episode.episode, replace(outcome.episode, meta=meta))
    rows = [asdict(row) for row in sorted(records, key=lambda row: row.episode)]
    atomic_write(note, json.dumps(rows).encode())
    return len(rows)


def dagger_actor(spec: RolloutSpec, environment: Environment) -> DaggerActor:
    """Policy and expert sharing control of this environment.

    Raises:
        PlaylearnError: either cannot act there.
    """
    policy = spec.policy.build(environment)
    rule = replace(spec.rule, plans=policy.n_action_steps)
    return DaggerActor(policy, spec.expert(environment), rule, policy.std)


def make_store(suite: SuiteConfig, cameras: Sequence[str], path: Path) -> None:
    """An empty store for episodes of a suite's environment seen by these cameras, unless there is one."""
    if (path / "store.json").exists():
        return
    NativeStore.create(path, store_spec(cached_env(suite.environment), cameras))


def _set_up(
    spec: RolloutSpec, numbers: Sequence[int], environment: Environment, expert: Actor
) -> tuple[list[EvalEpisode], list[RolloutRecord]]:
    """Starts and goals; and the records of episodes for which there are none."""
    suite, episodes, without = spec.suite, [], []
    for number in numbers:
        try:
            episodes.append(
                suite.kind.setup(environment, expert, number, spec.seed, suite.max_steps, spec.policy.cameras())
            )
        except UsageError:
            raise
        except PlaylearnError as error:
            without.append(RolloutRecord(number, "", kept=False, ended=f"not set up: {error}"))
    return episodes, without


def _record(episode: EvalEpisode, outcome: Outcome) -> RolloutRecord:
    recorded = outcome.episode
    expert_steps = 0 if recorded is None else int(recorded.intervention.sum())
    kept = outcome.ended == STOPPED
    solved_without_expert = kept and expert_steps == 0
    return RolloutRecord(
        episode.episode, episode.task, kept, outcome.ended, outcome.steps, expert_steps, solved_without_expert
    )


def _note(folder: Path, batch: Sequence[int]) -> Path:
    return folder / f"{batch[0]:06d}.json"
