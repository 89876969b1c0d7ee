"""`playlearn eval`: assembles a suite, contenders and an executor, and writes what came out."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from playlearn.config import atomic_write, git_revision, to_dict, versions
from playlearn.config.schema import nearest
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.actor_recipes import ActorRecipe, ExpertRecipe, RandomRecipe, scripted, trained
from playlearn.evaluation.results import by_policy, curve, ends, parquet, summary, to_film, to_show
from playlearn.evaluation.suite import SuiteConfig, load_suite
from playlearn.evaluation.worker import EpisodeResult, Trajectory, draw_trajectory, lost, run_batch
from playlearn.executor import Executor, Job, LocalExecutorConfig, LostError
from playlearn.report.page import Shown, page
from playlearn.report.pictures import Pictures
from playlearn.report.progress import Progress
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment, EnvironmentSpec

GOALS = ("image", "state")
POLICIES = ("expert", "random")
SHOWN_SUCCESSES, SHOWN_FAILURES = 1, 2  # of each task
FILMED_SUCCESSES, FILMED_FAILURES = 2, 3  # in all


def evaluate(
    suite: Path,
    *,
    out: Path,
    run: Path | None = None,
    encoder: Path | None = None,
    policy: str | None = None,
    goal: str = "image",
    episodes: int | None = None,
    workers: int | None = None,
    seed: int | None = None,
    references: bool = True,
    overrides: Sequence[str] = (),
    expert: Callable[[Environment], Actor] | None = None,
) -> dict[str, Any]:
    """Judge a run's policy, the expert or chance on a suite; write results.json, episodes.parquet and report.html.

    encoder: a run whose image encoder a state policy looks through.
    With `references` the expert and chance attempt the same episodes. `expert` builds the
    environment's expert; by default it is that of `playlearn.teleop`.

    Returns what results.json says.

    Raises:
        UsageError: arguments, suite or goal modality are wrong.
        CheckpointError: there is no such run, or it was made for another environment.
        PlaylearnError: the suite cannot be set up.
    """
    started = time.perf_counter()
    given = {"episodes": episodes, "seed": seed}
    config = load_suite(suite, [*overrides, *(f"--{k}={v}" for k, v in given.items() if v is not None)])
    config = replace(config, kind=config.kind.prepare(run))
    teacher = ExpertRecipe(expert or scripted)
    contenders = _contenders(config, run, encoder, policy, goal, teacher, references=references)
    executor = LocalExecutorConfig(workers=workers).build()
    _make(out)

    main = contenders[0].name
    with executor:
        gathered = _evaluate(config, contenders, teacher, executor)
        if gathered.spec is None:
            raise PlaylearnError(f"every worker was lost; the last: {gathered.episode_results[-1].reason}")
        grouped = by_policy(gathered.episode_results)
        shown, note = _pictures(config, ends(grouped[main]), gathered.trajectories, executor)
    results = {
        "suite": config.name,
        "goal_modality": goal,
        **summary(grouped[main]),
        "references": {name: summary(grouped[name]) for name in POLICIES if name in grouped},
        "redraws": sum(episode_result.redraws for episode_result in grouped[main]),
        "seed": config.seed,
        "achieved_names": list(gathered.spec.achieved_names),
        "renderer": gathered.renderer,
        "versions": versions(),
        "revision": git_revision(),
        "policy": {"name": main, **contenders[0].describe()},
        "config": to_dict(config),
        "seconds": round(time.perf_counter() - started, 3),
    }
    longest = max(config.max_steps, *(episode_result.steps for episode_result in gathered.episode_results))
    curves = {name: curve(grouped[name], longest) for name in grouped}
    atomic_write(
        out / "episodes.parquet", parquet([episode_result for rows in grouped.values() for episode_result in rows])
    )
    atomic_write(out / "report.html", page(results, curves, gathered.spec.fps, shown, note).encode())
    atomic_write(out / "results.json", json.dumps(results, indent=2).encode())
    return results


@dataclass(eq=False)
class _Gathered:
    """What the workers gave. tracks: of the first contender, and only those that may be shown."""

    episode_results: list[EpisodeResult] = field(default_factory=list)
    trajectories: dict[int, Trajectory] = field(default_factory=dict)
    renderer: str = ""
    spec: EnvironmentSpec | None = None


def _evaluate(
    config: SuiteConfig, contenders: Sequence[ActorRecipe], expert: ExpertRecipe, executor: Executor
) -> _Gathered:
    """Every contender's attempt at every episode."""
    jobs = {
        batch[0]: Job(
            key=batch[0],
            function=run_batch,
            kwargs={"suite": config, "episodes": batch, "contenders": tuple(contenders), "expert": expert},
            seed=config.seed,
        )
        for batch in config.batches()
    }
    gathered = _Gathered()
    with Progress(config.name, config.episodes, "episode", workers=executor.workers) as progress:
        for result in executor.run(jobs.values(), keep_going=True):
            if result.error is None:
                gathered.episode_results += result.value.episode_results
                gathered.trajectories |= result.value.trajectories[contenders[0].name]
                gathered.renderer, gathered.spec = result.value.renderer, result.value.spec
            elif isinstance(result.error, LostError):
                batch = jobs[result.key].kwargs["episodes"]
                gathered.episode_results += [
                    lost(e, c.name, f"crashed: {result.error}") for e in batch for c in contenders
                ]
            else:
                raise result.error  # it could not even be set up: there is nothing to judge
            main = ends(
                [
                    episode_result
                    for episode_result in gathered.episode_results
                    if episode_result.policy == contenders[0].name
                ]
            )
            keep = {episode_result.episode for episode_result in to_show(main, SHOWN_SUCCESSES, SHOWN_FAILURES)}
            gathered.trajectories = {
                episode: trajectory for episode, trajectory in gathered.trajectories.items() if episode in keep
            }
            progress.to(len(main), seconds=result.seconds)
    return gathered


def _pictures(
    config: SuiteConfig,
    episode_results: Sequence[EpisodeResult],
    trajectories: dict[int, Trajectory],
    executor: Executor,
) -> tuple[list[Shown], str]:
    """Start, goal and final of a few attempts, films of fewer; and why there are none, if there are none."""
    chosen = [a for a in to_show(episode_results, SHOWN_SUCCESSES, SHOWN_FAILURES) if a.episode in trajectories]
    filmed = to_film(chosen, FILMED_SUCCESSES, FILMED_FAILURES)
    jobs = [
        Job(
            key=episode_result.episode,
            function=draw_trajectory,
            kwargs={
                "suite": config,
                "trajectory": trajectories[episode_result.episode],
                "film": episode_result.episode in filmed,
            },
        )
        for episode_result in chosen
    ]
    drawn: dict[int, Pictures] = {}
    for result in executor.run(jobs, keep_going=True):
        if result.error is not None:
            # A report without pictures is worth more than none: the attempts are done.
            return [], f"No pictures: {result.error}"
        drawn[result.key] = result.value
    shown = [Shown(a.episode, a.task, a.success, a.reason, steps=a.steps, pictures=drawn[a.episode]) for a in chosen]
    return shown, ""


def _contenders(
    config: SuiteConfig,
    run: Path | None,
    encoder: Path | None,
    policy: str | None,
    goal: str,
    expert: ExpertRecipe,
    *,
    references: bool,
) -> list[ActorRecipe]:
    """Who attempts the suite, the one that is judged first; refuses what cannot work before anything is simulated."""
    if goal not in GOALS:
        raise UsageError(f"--goal is {goal!r}{nearest(goal, GOALS)}")
    if (run is None) == (policy is None):
        raise UsageError("give either --run RUN, a trained policy, or --policy expert|random, a reference")
    known: dict[str, ActorRecipe] = {expert.name: expert, "random": RandomRecipe()}
    if policy is not None and policy not in known:
        raise UsageError(f"--policy is {policy!r}{nearest(policy, POLICIES)}; a trained one is given as --run RUN")
    if run is not None:
        judged = trained(run, goal, config, encoder)
        judged.check()
        return [judged, *(known.values() if references else ())]
    reference = known.pop(str(policy))
    return [reference, *(known.values() if references else ())]


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot write to --out {out}: {error.strerror}; name a folder") from error
