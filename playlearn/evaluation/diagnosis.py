"""`playlearn diagnose`: what limits a trained policy on a suite, and what its failures look like.

Causes and numbers are worked out where the attempts are made; the expert attempts the same episodes.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from playlearn.config import atomic_write, from_dict, to_dict, versions
from playlearn.data import DataConfig, PlayDataset
from playlearn.episode import read_annotation
from playlearn.errors import PlaylearnError, StoreError, UsageError
from playlearn.evaluation import ActorRecipe, ExpertRecipe, SuiteConfig, load_suite, scripted, trained
from playlearn.evaluation.failure_modes import (
    ENDED,
    FAILURE_MODES,
    FailureModesConfig,
    FailureReport,
    by_grasp,
    classify_failure,
)
from playlearn.evaluation.results import ends, summary
from playlearn.evaluation.worker import EpisodeResult, Trajectory, env_of, lost, run_batch
from playlearn.executor import Executor, Job, LocalExecutorConfig, LostError
from playlearn.policies import Policy
from playlearn.report.diagnosis import diagnosis_page, strip
from playlearn.report.intervals import wilson
from playlearn.report.progress import Progress
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment
from playlearn.store import open_store, parse_store

STRIPS = 2  # of each cause
EXAMPLES = 2048  # of held-out play, on which actions are compared
BINS = 4  # of the expert's time
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Watched:
    """One cohort. findings: episode -> why it failed, for those that did; tracks of the same."""

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
    """Let a run's policy and the expert attempt a suite; write diagnosis.json and diagnosis.html into `out`.

    Returns what diagnosis.json says.

    Raises:
        UsageError: arguments, suite or goal modality are wrong.
        CheckpointError: there is no such run, or it was made for another environment.
        PlaylearnError: the suite cannot be set up.
    """
    began = time.perf_counter()
    given = {"episodes": episodes, "seed": seed}
    config = load_suite(suite, [*overrides, *(f"--{k}={v}" for k, v in given.items() if v is not None)])
    config = replace(config, kind=config.kind.prepare(run))
    policy = trained(run, goal, config)
    policy.check()
    teacher = ExpertRecipe(expert or scripted)
    failure_modes = failure_modes or FailureModesConfig()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot write to --out {out}: {error.strerror}; name a folder") from error
    with LocalExecutorConfig(workers=workers).build() as executor:
        watched = _watch(config, (policy, teacher), teacher, failure_modes, executor)
        mine = [episode_result for episode_result in watched.episode_results if episode_result.policy == policy.name]
        its = [episode_result for episode_result in watched.episode_results if episode_result.policy == teacher.name]
        failed = [episode_result for episode_result in ends(mine) if not episode_result.success]
        strips, note = _strips(config, failed, watched, executor)
    results = {
        "suite": config.name,
        "run": str(run),
        "goal_modality": goal,
        **summary(mine),
        "expert": summary(its),
        "failure_modes": _failure_modes(failed, watched.reports, len(ends(mine))),
        "by_expert_seconds": _by_time(mine, its, watched.fps),
        "action_error": action_errors(run),
        "failures": [_failure(episode_result, watched.reports) for episode_result in failed],
        "seed": config.seed,
        "versions": versions(),
        "config": {"suite": to_dict(config), "failure_modes": to_dict(failure_modes)},
        "seconds": round(time.perf_counter() - began, 3),
    }
    atomic_write(out / "diagnosis.json", json.dumps(results, indent=1).encode())
    atomic_write(out / "diagnosis.html", diagnosis_page(results, FAILURE_MODES, strips, note).encode())
    return results


def format_summary(results: Row) -> str:
    """The gist, for a terminal."""
    low, high = results["ci95"]
    expert = f"the expert {results['expert']['success_rate']:.1%}"
    lines = [
        f"{results['suite']}: {results['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {results['episodes']}; {expert}",
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
    worst = ", ".join(f"{skill or 'play'} {row['error']:.3f}" for skill, row in list(errors["skills"].items())[:6])
    return "\n".join([*lines, f"held-out action error, the worst skills: {worst or errors['note']}"])


def _watch(
    config: SuiteConfig,
    contenders: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    failure_modes: FailureModesConfig,
    executor: Executor,
) -> Watched:
    """All cohorts together."""
    jobs = {
        batch[0]: Job(
            key=batch[0],
            function=watch_batch,
            kwargs={
                "suite": config,
                "episodes": batch,
                "contenders": tuple(contenders),
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
                episode_results += [lost(e, c.name, f"crashed: {result.error}") for e in batch for c in contenders]
            else:
                raise result.error
            done += len(batch)
            progress.to(done, seconds=result.seconds)
    if not fps:
        raise PlaylearnError(f"every worker was lost; the last: {episode_results[-1].reason}")
    return Watched(tuple(episode_results), reports, trajectories, fps)


def watch_batch(
    suite: SuiteConfig,
    episodes: Sequence[int],
    contenders: Sequence[ActorRecipe],
    expert: ExpertRecipe,
    failure_modes: FailureModesConfig,
) -> Watched:
    """What one worker does: the attempts of a contender and the expert, and why those of the former failed."""
    result = run_batch(suite, episodes, contenders, expert, tracked=2)
    env = env_of(suite)
    mine = [episode_result for episode_result in result.episode_results if episode_result.policy == contenders[0].name]
    failed = {episode_result.episode: episode_result for episode_result in ends(mine) if not episode_result.success}
    own, shown = (result.trajectories[contender.name] for contender in contenders)
    trajectories = {episode: trajectory for episode, trajectory in own.items() if episode in failed}
    reached = {a.episode for a in ends([a for a in result.episode_results if a.policy == expert.name]) if a.success}
    reports = {}
    for episode, trajectory in trajectories.items():
        episode_result = failed[episode]
        if episode_result.reason.startswith("crashed"):
            continue
        goal = np.array(episode_result.goal_achieved, np.float32)
        judge = suite.kind.judge(env, episode_result.task)
        content = np.array([judge(trajectory.achieved[0], row, goal) for row in trajectory.achieved])
        content[0] = False  # what is there before anything is done was not reached
        early = not episode_result.reason.startswith("not reached")
        # What the expert did without a grasp does not fail as one; of a chain its last goal alone is known.
        model = shown.get(episode) if episode in reached else None
        grasping = True
        if model is not None and np.array_equal(model.goal_sim_state, trajectory.goal_sim_state):
            grasping = by_grasp(env, model.achieved, model.proprio, goal, failure_modes)
        reports[episode] = classify_failure(
            env, trajectory.achieved, trajectory.proprio, goal, content, early, failure_modes, grasping
        )
    return Watched(result.episode_results, reports, trajectories, env.spec.fps)


def _failure_modes(
    failed: Sequence[EpisodeResult], reports: Mapping[int, FailureReport], episodes: int
) -> dict[str, Row]:
    """Cause -> its count, its share of the failures and of all episodes, how many stalled or still held it, by task."""
    named = {a.episode: reports[a.episode].failure_mode if a.episode in reports else ENDED for a in failed}
    rows: dict[str, Row] = {}
    for failure_mode in FAILURE_MODES:
        own = [episode_result for episode_result in failed if named[episode_result.episode] == failure_mode]
        stalled = [a for a in own if a.episode in reports and reports[a.episode].stalled_from is not None]
        rows[failure_mode] = {
            "count": len(own),
            "fraction": len(own) / max(1, len(failed)),
            "ci95": list(wilson(len(own), len(failed))),
            "of_all": len(own) / episodes,
            "stalled": len(stalled),
            "holding": sum(a.episode in reports and reports[a.episode].holding for a in own),
            "tasks": dict(Counter(episode_result.task for episode_result in own).most_common()),
        }
    return dict(sorted(rows.items(), key=lambda item: int(item[1]["count"]), reverse=True))


def _failure(episode_result: EpisodeResult, reports: Mapping[int, FailureReport]) -> Row:
    row = {
        "episode": episode_result.episode,
        "task": episode_result.task,
        "made_by": episode_result.made_by,
        "link": episode_result.link,
    }
    row |= {"steps": episode_result.steps, "reason": episode_result.reason}
    found = reports.get(episode_result.episode)  # what crashed has none
    return row | ({"failure_mode": ENDED} if found is None else asdict(found) | {"asked": list(found.asked)})


def _by_time(mine: Sequence[EpisodeResult], its: Sequence[EpisodeResult], fps: float) -> list[Row]:
    """Success of the goals that the expert reached, by how long it took: as many goals in each of a few bins."""
    took = {(a.episode, a.link): a.steps / fps for a in its if a.success}
    known = sorted((took[key], a.success) for a in mine if (key := (a.episode, a.link)) in took)
    rows = []
    for part in np.array_split(np.arange(len(known)), min(BINS, max(1, len(known)))):
        if len(part):
            own = [known[k] for k in part]
            won = sum(success for _, success in own)
            rows.append(
                {
                    "from": own[0][0],
                    "to": own[-1][0],
                    "episodes": len(own),
                    "success_rate": won / len(own),
                    "ci95": list(wilson(won, len(own))),
                }
            )
    return rows


@torch.no_grad()
def action_errors(run: Path) -> Row:
    """Mean error of the first action of a chunk, in units of the action, by the skill of that step of held-out play.

    The play is what the run was trained on, the share of it that was held out; the worst skill comes first.
    """
    none: Row = {"skills": {}, "examples": 0, "note": ""}
    path = run / "config.yaml"
    raw = yaml.safe_load(path.read_text()) if path.is_file() else None
    gone = none | {"note": "not measured: the run's play is not there"}
    if not raw:
        return gone
    try:
        store = open_store(parse_store(raw["store"]))
    except StoreError:
        return gone
    data = from_dict(DataConfig, raw["data"])
    if data.val_fraction <= 0:
        return none | {"note": "not measured: the run held no play out"}
    dataset: PlayDataset = data.build(store, "val", int(raw.get("seed", 0)))
    policy = Policy.load(run / "policy").eval()
    names = [store.meta(int(i)).skills for i in range(len(store))]
    errors: dict[str, list[float]] = {}
    drawn = np.random.default_rng(0).permutation(len(dataset))[:EXAMPLES]
    for part in np.array_split(drawn, max(1, len(drawn) // 256)):
        batch = dataset.batch(0, part)
        off = (policy.act(batch, torch.Generator().manual_seed(0)) - batch.action)[:, 0].abs().mean(dim=1)
        for error, i, t in zip(off.tolist(), *dataset.where(part), strict=True):
            skill = store.array(int(i), "skill")[t]
            name = read_annotation(names[i][skill])[0] if names[i] else ""
            errors.setdefault(name, []).append(error)
    worst = sorted(errors, key=lambda name: float(np.mean(errors[name])), reverse=True)
    rows = {name: {"examples": len(errors[name]), "error": float(np.mean(errors[name]))} for name in worst}
    return none | {"skills": rows, "examples": len(drawn)}


def _strips(
    config: SuiteConfig, failed: Sequence[EpisodeResult], watched: Watched, executor: Executor
) -> tuple[dict[str, list[tuple[str, bytes]]], str]:
    """Cause -> captions and film strips of its first failures; and why there are none, if there are none."""
    chosen: dict[int, EpisodeResult] = {}
    for failure_mode in FAILURE_MODES:
        own = [
            a
            for a in failed
            if a.episode in watched.reports and watched.reports[a.episode].failure_mode == failure_mode
        ]
        firsts = list({episode_result.task: episode_result for episode_result in reversed(own)}.values())[
            ::-1
        ]  # of as many tasks
        chosen |= {episode_result.episode: episode_result for episode_result in firsts[:STRIPS]}
    jobs = [Job(e, draw_strip, {"suite": config, "trajectory": watched.trajectories[e]}) for e in chosen]
    shown: dict[str, list[tuple[str, bytes]]] = {}
    for result in executor.run(jobs, keep_going=True):
        if result.error is not None:
            return {}, f"No pictures: {result.error}"  # the numbers are worth having without
        episode_result, report = chosen[result.key], watched.reports[result.key]
        words = [
            f"episode {episode_result.episode}",
            episode_result.task,
            episode_result.made_by,
            f"to move: {', '.join(report.asked)}",
        ]
        words += [] if report.closest is None else [f"hand at best {100 * report.closest:.0f} cm away"]
        words += [] if report.off is None else [f"closed {100 * report.off:.0f} cm off"]
        words += ["holds it"] if report.holding else []
        words += [] if report.stalled_from is None else [f"still from {report.stalled_from:.1f} s on"]
        shown.setdefault(report.failure_mode, []).append((" · ".join(word for word in words if word), result.value))
    return {failure_mode: sorted(shown[failure_mode]) for failure_mode in FAILURE_MODES if failure_mode in shown}, ""


def draw_strip(suite: SuiteConfig, trajectory: Trajectory) -> bytes:
    """The film strip of an attempt, drawn by the worker that this runs in."""
    return strip(env_of(suite), trajectory.states, trajectory.goal_sim_state, suite.camera)
