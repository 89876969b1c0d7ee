"""`playlearn diagnose`: what limits a trained policy on a suite, and what its failures look like.

Failure modes are classified in the workers that roll out the policy; the expert is evaluated on the same episodes.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import atomic_write_all, held, to_dict, versions
from playlearn.errors import PlaylearnError
from playlearn.evaluation.action_error import action_errors
from playlearn.evaluation.actor_recipes import ActorRecipe, ExpertRecipe, scripted, trained
from playlearn.evaluation.failure_modes import (
    ENDED,
    FAILURE_MODES,
    FailureModesConfig,
    FailureReport,
    classify_failure,
    uses_grasp,
)
from playlearn.evaluation.results import last_goals, summary
from playlearn.evaluation.suite import SuiteConfig, prepared_suite
from playlearn.evaluation.worker import EpisodeResult, Trajectory, env_of, lost, run_batch
from playlearn.executor import Executor, Job, LocalExecutorConfig, LostError
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.privileges import Privileges
from playlearn.report.diagnosis import diagnosis_page, strip
from playlearn.report.intervals import wilson
from playlearn.report.progress import Progress
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment

STRIPS = 2  # of each failure mode
BINS = 4  # of the expert's time
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class DiagnosedBatch:
    """Results of a policy and the expert on some episodes.

    episode_results: of both.
    reports: episode -> why the policy failed, for its failures.
    trajectories: episode -> the policy's trajectory, for its failures.
    fps: control steps a second.
    """

    episode_results: tuple[EpisodeResult, ...]
    reports: Mapping[int, FailureReport]
    trajectories: Mapping[int, Trajectory]
    fps: float


def diagnose(
    run: Path,
    suite: Path,
    out: Path,
    *,
    goal: str = "image",
    episodes: int | None = None,
    workers: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
    failure_modes: FailureModesConfig | None = None,
    expert: Callable[[Environment], Actor] | None = None,
) -> Row:
    """Evaluate a run's policy and the expert on a suite; write diagnosis.json and diagnosis.html into `out`.

    Arguments are those of `evaluate`; failure_modes: thresholds.

    Returns the content of diagnosis.json.

    Raises:
        UsageError: arguments, suite or goal modality are wrong.
        CheckpointError: there is no such run, or it was made for another environment.
        PlaylearnError: the suite cannot be set up.
    """
    started = time.perf_counter()
    config = prepared_suite(suite, run, episodes, seed, overrides)
    policy_recipe = trained(run, goal, config)
    policy_recipe.check()
    expert_recipe = ExpertRecipe(expert or scripted)
    failure_modes = failure_modes or FailureModesConfig()
    with held(out), LocalExecutorConfig(workers=workers).build() as executor:
        diagnosed = _run_batches(config, (policy_recipe, expert_recipe), expert_recipe, failure_modes, executor)
        policy_rows = [row for row in diagnosed.episode_results if row.policy == policy_recipe.name]
        expert_rows = [row for row in diagnosed.episode_results if row.policy == expert_recipe.name]
        failed = [row for row in last_goals(policy_rows) if not row.success]
        strips, note = _strips(config, failed, diagnosed, executor)
        results = {
            "suite": config.name,
            "run": str(run),
            "goal_modality": goal,
            **summary(policy_rows),
            PRIVILEGED: policy_recipe.privileges().to_dict(),
            "expert": summary(expert_rows),
            "failure_modes": _failure_modes(failed, diagnosed.reports, len(last_goals(policy_rows))),
            "by_expert_seconds": _by_expert_seconds(policy_rows, expert_rows, diagnosed.fps),
            "action_error": action_errors(run),
            "failures": [_failure(row, diagnosed.reports) for row in failed],
            "seed": config.seed,
            "versions": versions(),
            "config": {"suite": to_dict(config), "failure_modes": to_dict(failure_modes)},
            "seconds": round(time.perf_counter() - started, 3),
        }
        html = diagnosis_page(results, FAILURE_MODES, strips, note)
        atomic_write_all(
            {out / "diagnosis.json": json.dumps(results, indent=1).encode(), out / "diagnosis.html": html.encode()}
        )
    return results


def format_summary(results: Row) -> str:
    """A short summary, for a terminal."""
    low, high = results["ci95"]
    expert = f"the expert {results['expert']['success_rate']:.1%}"
    lines = [
        f"{results['suite']}: {results['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {results['episodes']}; {expert}",
        f"privileged information: {Privileges.from_dict(results[PRIVILEGED])}",
        f"{'failures':<30} {'fraction':>6} {'still at the end':>17}  mostly in",
    ]
    for failure_mode, row in results["failure_modes"].items():
        if row["count"]:
            tasks = ", ".join(f"{task} {count}" for task, count in list(row["tasks"].items())[:4])
            lines.append(f"{failure_mode:<30} {row['fraction']:6.0%} {row['stalled']:>9} of {row['count']:<4}  {tasks}")
    lines += [
        f"where the expert takes {row['from']:.1f} to {row['to']:.1f} s: {row['success_rate']:.0%} of {row['episodes']}"
        for row in results["by_expert_seconds"]
    ]
    errors = results["action_error"]
    largest = ", ".join(f"{skill or 'play'} {row['error']:.3f}" for skill, row in list(errors["skills"].items())[:6])
    return "\n".join([*lines, f"action error on held-out play, largest by skill: {largest or errors['note']}"])


def _run_batches(
    config: SuiteConfig,
    recipes: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    failure_modes: FailureModesConfig,
    executor: Executor,
) -> DiagnosedBatch:
    """All batches together."""
    jobs = {
        batch[0]: Job(
            key=batch[0],
            function=diagnose_batch,
            kwargs={
                "suite": config,
                "episodes": batch,
                "recipes": tuple(recipes),
                "expert": expert,
                "failure_modes": failure_modes,
            },
            seed=config.seed,
        )
        for batch in config.batches()
    }
    episode_results: list[EpisodeResult] = []
    reports: dict[int, FailureReport] = {}
    trajectories: dict[int, Trajectory] = {}
    fps, done = 0.0, 0
    with Progress(config.name, config.episodes, "episode", workers=executor.workers) as progress:
        for result in executor.run(jobs.values(), keep_going=True):
            batch = jobs[result.key].kwargs["episodes"]
            if result.error is None:
                episode_results += result.value.episode_results
                reports |= result.value.reports
                trajectories |= result.value.trajectories
                fps = result.value.fps
            elif isinstance(result.error, LostError):
                episode_results += [lost(e, r.name, f"crashed: {result.error}") for e in batch for r in recipes]
            else:
                raise result.error
            done += len(batch)
            progress.to(done, seconds=result.seconds)
    if not fps:
        raise PlaylearnError(f"every worker was lost; the last: {episode_results[-1].reason}")
    return DiagnosedBatch(tuple(episode_results), reports, trajectories, fps)


def diagnose_batch(
    suite: SuiteConfig,
    episodes: Sequence[int],
    recipes: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    failure_modes: FailureModesConfig,
) -> DiagnosedBatch:
    """What one worker does: roll out policy and expert, and classify the policy's failures."""
    result = run_batch(suite, episodes, recipes, expert, num_tracked=2)
    env = env_of(suite)
    policy_rows = [row for row in result.episode_results if row.policy == recipes[0].name]
    expert_rows = [row for row in result.episode_results if row.policy == expert.name]
    failed = {row.episode: row for row in last_goals(policy_rows) if not row.success}
    expert_succeeded = {row.episode for row in last_goals(expert_rows) if row.success}
    of_policy, of_expert = (result.trajectories[recipe.name] for recipe in recipes)
    trajectories = {episode: trajectory for episode, trajectory in of_policy.items() if episode in failed}
    reports = {}
    for episode, trajectory in trajectories.items():
        row = failed[episode]
        if row.reason.startswith("crashed"):
            continue
        goal = np.array(row.goal_achieved, np.float32)
        judge = suite.kind.judge(env, row.task)
        success = np.array([judge(trajectory.achieved[0], achieved, goal) for achieved in trajectory.achieved])
        success[0] = False  # the state before the first action does not count
        ended_early = not row.reason.startswith("not reached")
        # A goal that the expert reached without a grasp needs none; of a chain only the last goal is known.
        model = of_expert.get(episode) if episode in expert_succeeded else None
        needs_grasp = True
        if model is not None and np.array_equal(model.goal_sim_state, trajectory.goal_sim_state):
            needs_grasp = uses_grasp(env, model.achieved, model.proprio, goal, failure_modes)
        reports[episode] = classify_failure(
            env, trajectory.achieved, trajectory.proprio, goal, success, ended_early, failure_modes, needs_grasp
        )
    return DiagnosedBatch(result.episode_results, reports, trajectories, env.spec.fps)


def _failure_modes(
    failed: Sequence[EpisodeResult], reports: Mapping[int, FailureReport], episodes: int
) -> dict[str, Row]:
    """Failure mode -> count, fractions of failures and of all episodes, how many stalled or held the object, tasks."""
    named = {row.episode: reports[row.episode].failure_mode if row.episode in reports else ENDED for row in failed}
    rows: dict[str, Row] = {}
    for failure_mode in FAILURE_MODES:
        own = [row for row in failed if named[row.episode] == failure_mode]
        known = [reports[row.episode] for row in own if row.episode in reports]
        rows[failure_mode] = {
            "count": len(own),
            "fraction": len(own) / max(1, len(failed)),
            "ci95": list(wilson(len(own), len(failed))),
            "fraction_of_episodes": len(own) / episodes,
            "stalled": sum(report.stalled_from is not None for report in known),
            "holding": sum(report.holding for report in known),
            "tasks": dict(Counter(row.task for row in own).most_common()),
        }
    return dict(sorted(rows.items(), key=lambda item: int(item[1]["count"]), reverse=True))


def _failure(row: EpisodeResult, reports: Mapping[int, FailureReport]) -> Row:
    columns = ("episode", "task", "expert_tasks", "goal_index", "steps", "reason")
    report = reports.get(row.episode)  # a crashed rollout has none
    found = {"failure_mode": ENDED} if report is None else asdict(report) | {"targets": list(report.targets)}
    return {name: getattr(row, name) for name in columns} | found


def _by_expert_seconds(
    policy_rows: Sequence[EpisodeResult], expert_rows: Sequence[EpisodeResult], fps: float
) -> list[Row]:
    """Success on the goals that the expert reached, by its time, in a few bins with the same number of goals."""
    took = {(row.episode, row.goal_index): row.steps / fps for row in expert_rows if row.success}
    known = sorted((took[key], row.success) for row in policy_rows if (key := (row.episode, row.goal_index)) in took)
    rows = []
    for part in np.array_split(np.arange(len(known)), min(BINS, max(1, len(known)))):
        if len(part):
            own = [known[k] for k in part]
            successes = sum(success for _, success in own)
            rows.append(
                {
                    "from": own[0][0],
                    "to": own[-1][0],
                    "episodes": len(own),
                    "success_rate": successes / len(own),
                    "ci95": list(wilson(successes, len(own))),
                }
            )
    return rows


def _strips(
    config: SuiteConfig, failed: Sequence[EpisodeResult], diagnosed: DiagnosedBatch, executor: Executor
) -> tuple[dict[str, list[tuple[str, bytes]]], str]:
    """Failure mode -> captions and film strips of its first failures; and the reason if there are none."""
    known = [row for row in failed if row.episode in diagnosed.reports]
    chosen: dict[int, EpisodeResult] = {}
    for failure_mode in FAILURE_MODES:
        own = [row for row in known if diagnosed.reports[row.episode].failure_mode == failure_mode]
        firsts = list({row.task: row for row in reversed(own)}.values())[::-1]  # of different tasks
        chosen |= {row.episode: row for row in firsts[:STRIPS]}
    jobs = [Job(e, draw_strip, {"suite": config, "trajectory": diagnosed.trajectories[e]}) for e in chosen]
    shown: dict[str, list[tuple[str, bytes]]] = {}
    for result in executor.run(jobs, keep_going=True):
        if result.error is not None:
            return {}, f"No pictures: {result.error}"  # the numbers are useful without them
        row, report = chosen[result.key], diagnosed.reports[result.key]
        shown.setdefault(report.failure_mode, []).append((_caption(row, report), result.value))
    return {failure_mode: sorted(shown[failure_mode]) for failure_mode in FAILURE_MODES if failure_mode in shown}, ""


def _caption(row: EpisodeResult, report: FailureReport) -> str:
    facts = [f"episode {row.episode}", row.task, row.expert_tasks, f"targets: {', '.join(report.targets)}"]
    facts += [] if report.min_distance is None else [f"nearest {100 * report.min_distance:.0f} cm"]
    facts += [] if report.grasp_distance is None else [f"gripper closed {100 * report.grasp_distance:.0f} cm off"]
    facts += ["holds it"] if report.holding else []
    facts += [] if report.stalled_from is None else [f"stalled from {report.stalled_from:.1f} s on"]
    return " · ".join(fact for fact in facts if fact)


def draw_strip(suite: SuiteConfig, trajectory: Trajectory) -> bytes:
    """The film strip of an episode, rendered by the worker process."""
    return strip(env_of(suite), trajectory.sim_states, trajectory.goal_sim_state, suite.camera)
