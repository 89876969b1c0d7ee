"""`playlearn eval`: assembles a suite, actor recipes and an executor, and writes the results."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from playlearn.config import atomic_write_all, git_revision, held, to_dict, versions
from playlearn.config.schema import nearest
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation.actor_recipes import ActorRecipe, ExpertRecipe, RandomRecipe, scripted, trained
from playlearn.evaluation.results import by_policy, curve, last_goals, parquet, summary, to_film, to_show
from playlearn.evaluation.suite import SuiteConfig, prepared_suite
from playlearn.evaluation.worker import EpisodeResult, Trajectory, draw_trajectory, lost, run_batch
from playlearn.executor import Executor, Job, LocalExecutorConfig, LostError
from playlearn.privileges import KEY as PRIVILEGED
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
    """Evaluate a run's policy, the expert or the random policy on a suite.

    Writes results.json, episodes.parquet and report.html into `out`.

    suite: file of the suite.
    out: output folder.
    run: output folder of `playlearn train`.
    encoder: run whose image encoder estimates the state for a state policy.
    policy: "expert" or "random", instead of a run.
    goal: how goals are shown, "image" or "state".
    episodes: instead of the suite's.
    workers: processes; None: one a core, 0: this process.
    seed: instead of the suite's.
    references: also evaluate the expert and the random policy, on the same episodes.
    overrides: of the suite's fields, as on the command line.
    expert: builds the environment's expert; by default that of `playlearn.oracles`.

    Returns the content of results.json.

    Raises:
        UsageError: arguments, suite or goal modality are wrong.
        CheckpointError: there is no such run, or it was made for another environment.
        BusyError: another process writes into `out`.
        DiskError: the disk is full; an earlier evaluation in `out` is whole.
        PlaylearnError: the suite cannot be set up.
    """
    started = time.perf_counter()
    config = prepared_suite(suite, run, episodes, seed, overrides)
    expert_recipe = ExpertRecipe(expert or scripted)
    recipes = _recipes(config, run, encoder, policy, goal, expert_recipe, references=references)
    executor = LocalExecutorConfig(workers=workers).build()
    with held(out):
        return _run(config, recipes, expert_recipe, executor, goal, out, started)


def _run(
    config: SuiteConfig,
    recipes: Sequence[ActorRecipe],
    expert_recipe: ExpertRecipe,
    executor: Executor,
    goal: str,
    out: Path,
    started: float,
) -> dict[str, Any]:
    """Evaluate and write into `out`."""
    main = recipes[0].name
    with executor:
        gathered = _evaluate(config, recipes, expert_recipe, executor)
        if gathered.spec is None:
            raise PlaylearnError(f"every worker was lost; the last: {gathered.episode_results[-1].reason}")
        grouped = by_policy(gathered.episode_results)
        shown, note = _pictures(config, last_goals(grouped[main]), gathered.trajectories, executor)
    results = {
        "suite": config.name,
        "goal_modality": goal,
        **summary(grouped[main]),
        PRIVILEGED: recipes[0].privileges().to_dict(),
        "references": {
            recipe.name: {**summary(grouped[recipe.name]), PRIVILEGED: recipe.privileges().to_dict()}
            for recipe in sorted(recipes, key=lambda recipe: recipe.name)
            if recipe.name in POLICIES
        },
        "redraws": sum(row.redraws for row in grouped[main]),
        "seed": config.seed,
        "achieved_names": list(gathered.spec.achieved_names),
        "renderer": gathered.renderer,
        "versions": versions(),
        "git_revision": git_revision(),
        "policy": {"name": main, **recipes[0].describe()},
        "config": to_dict(config),
        "seconds": round(time.perf_counter() - started, 3),
    }
    longest = max(config.max_steps, *(row.steps for row in gathered.episode_results))
    curves = {name: curve(grouped[name], longest) for name in grouped}
    atomic_write_all(
        {
            out / "episodes.parquet": parquet([row for rows in grouped.values() for row in rows]),
            out / "report.html": page(results, curves, gathered.spec.fps, shown, note).encode(),
            out / "results.json": json.dumps(results, indent=2).encode(),
        }
    )
    return results


@dataclass(eq=False)
class _Results:
    """What the workers returned.

    episode_results: of all policies.
    trajectories: of the first policy, only those that may be shown.
    renderer: what renders in the workers.
    spec: of the environment.
    """

    episode_results: list[EpisodeResult] = field(default_factory=list)
    trajectories: dict[int, Trajectory] = field(default_factory=dict)
    renderer: str = ""
    spec: EnvironmentSpec | None = None


def _evaluate(
    config: SuiteConfig, recipes: Sequence[ActorRecipe], expert: ExpertRecipe, executor: Executor
) -> _Results:
    """Evaluate all actors on all episodes."""
    jobs = {
        batch[0]: Job(
            key=batch[0],
            function=run_batch,
            kwargs={"suite": config, "episodes": batch, "recipes": tuple(recipes), "expert": expert},
            seed=config.seed,
        )
        for batch in config.batches()
    }
    gathered = _Results()
    with Progress(config.name, config.episodes, "episode", workers=executor.workers) as progress:
        for result in executor.run(jobs.values(), keep_going=True):
            if result.error is None:
                gathered.episode_results += result.value.episode_results
                gathered.trajectories |= result.value.trajectories[recipes[0].name]
                gathered.renderer, gathered.spec = result.value.renderer, result.value.spec
            elif isinstance(result.error, LostError):
                batch = jobs[result.key].kwargs["episodes"]
                gathered.episode_results += [
                    lost(e, c.name, f"crashed: {result.error}") for e in batch for c in recipes
                ]
            else:
                raise result.error  # the episode could not be set up
            main = last_goals([row for row in gathered.episode_results if row.policy == recipes[0].name])
            keep = {row.episode for row in to_show(main, SHOWN_SUCCESSES, SHOWN_FAILURES)}
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
    """Pictures of a few episodes and films of fewer; and the reason if there are none."""
    chosen = [row for row in to_show(episode_results, SHOWN_SUCCESSES, SHOWN_FAILURES) if row.episode in trajectories]
    filmed = to_film(chosen, FILMED_SUCCESSES, FILMED_FAILURES)
    jobs = [
        Job(
            key=row.episode,
            function=draw_trajectory,
            kwargs={
                "suite": config,
                "trajectory": trajectories[row.episode],
                "film": row.episode in filmed,
            },
        )
        for row in chosen
    ]
    drawn: dict[int, Pictures] = {}
    for result in executor.run(jobs, keep_going=True):
        if result.error is not None:
            # The episodes are done, so the report is written without pictures.
            return [], f"No pictures: {result.error}"
        drawn[result.key] = result.value
    shown = [
        Shown(row.episode, row.task, row.success, row.reason, steps=row.steps, pictures=drawn[row.episode])
        for row in chosen
    ]
    return shown, ""


def _recipes(
    config: SuiteConfig,
    run: Path | None,
    encoder: Path | None,
    policy: str | None,
    goal: str,
    expert: ExpertRecipe,
    *,
    references: bool,
) -> list[ActorRecipe]:
    """The actors, the evaluated one first; refuses what cannot work before anything is simulated."""
    if goal not in GOALS:
        raise UsageError(f"--goal is {goal!r}{nearest(goal, GOALS)}")
    if (run is None) == (policy is None):
        raise UsageError("give either --run RUN, a trained policy, or --policy expert|random, a reference")
    known: dict[str, ActorRecipe] = {expert.name: expert, "random": RandomRecipe()}
    if policy is not None and policy not in known:
        raise UsageError(f"--policy is {policy!r}{nearest(policy, POLICIES)}; a trained one is given as --run RUN")
    if run is not None:
        evaluated = trained(run, goal, config, encoder)
        evaluated.check()
        return [evaluated, *(known.values() if references else ())]
    reference = known.pop(str(policy))
    return [reference, *(known.values() if references else ())]
