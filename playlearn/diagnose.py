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
from playlearn.evaluate import Contender, Expert, SuiteConfig, load_suite, scripted, trained
from playlearn.evaluate.causes import CAUSES, ENDED, CausesConfig, Finding, by_grasp, find_cause
from playlearn.evaluate.cohort import Attempt, Track, lost, run_cohort, world_of
from playlearn.evaluate.results import ends, summary
from playlearn.executor import Executor, Job, LocalExecutorConfig, LostError
from playlearn.policies import Policy
from playlearn.report.diagnosis import diagnosis_page, strip
from playlearn.report.intervals import wilson
from playlearn.report.progress import Progress
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment
from playlearn.store import described, open_store

STRIPS = 2  # of each cause
EXAMPLES = 2048  # of held-out play, on which actions are compared
BINS = 4  # of the expert's time
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Watched:
    """One cohort. findings: episode -> why it failed, for those that did; tracks of the same."""

    attempts: tuple[Attempt, ...]
    findings: Mapping[int, Finding]
    tracks: Mapping[int, Track]
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
    causes: CausesConfig | None = None,
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
    teacher = Expert(expert or scripted)
    causes = causes or CausesConfig()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot write to --out {out}: {error.strerror}; name a folder") from error
    with LocalExecutorConfig(workers=workers).build() as executor:
        watched = _watch(config, (policy, teacher), teacher, causes, executor)
        mine = [attempt for attempt in watched.attempts if attempt.policy == policy.name]
        its = [attempt for attempt in watched.attempts if attempt.policy == teacher.name]
        failed = [attempt for attempt in ends(mine) if not attempt.success]
        strips, note = _strips(config, failed, watched, executor)
    results = {
        "suite": config.name,
        "run": str(run),
        "goal_modality": goal,
        **summary(mine),
        "expert": summary(its),
        "causes": _causes(failed, watched.findings, len(ends(mine))),
        "by_expert_seconds": _by_time(mine, its, watched.fps),
        "action_error": action_errors(run),
        "failures": [_failure(attempt, watched.findings) for attempt in failed],
        "seed": config.seed,
        "versions": versions(),
        "config": {"suite": to_dict(config), "causes": to_dict(causes)},
        "seconds": round(time.perf_counter() - began, 3),
    }
    atomic_write(out / "diagnosis.json", json.dumps(results, indent=1).encode())
    atomic_write(out / "diagnosis.html", diagnosis_page(results, CAUSES, strips, note).encode())
    return results


def said(results: Row) -> str:
    """The gist, for a terminal."""
    low, high = results["ci95"]
    expert = f"the expert {results['expert']['success_rate']:.1%}"
    lines = [
        f"{results['suite']}: {results['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {results['episodes']}; {expert}",
        f"{'failures':<30} {'share':>6} {'still at the end':>17}  mostly in",
    ]
    for cause, row in results["causes"].items():
        if row["count"]:
            tasks = ", ".join(f"{task} {count}" for task, count in list(row["tasks"].items())[:4])
            lines.append(f"{cause:<30} {row['share']:6.0%} {row['stalled']:>9} of {row['count']:<4}  {tasks}")
    lines += [
        f"where the expert takes {row['from']:.1f} to {row['to']:.1f} s: {row['success_rate']:.0%} of {row['episodes']}"
        for row in results["by_expert_seconds"]
    ]
    errors = results["action_error"]
    worst = ", ".join(f"{skill or 'play'} {row['error']:.3f}" for skill, row in list(errors["skills"].items())[:6])
    return "\n".join([*lines, f"held-out action error, the worst skills: {worst or errors['note']}"])


def _watch(
    config: SuiteConfig, contenders: Sequence[Contender], expert: Expert, causes: CausesConfig, executor: Executor
) -> Watched:
    """All cohorts together."""
    jobs = {
        cohort[0]: Job(
            key=cohort[0],
            function=watch_cohort,
            kwargs={
                "suite": config,
                "episodes": cohort,
                "contenders": tuple(contenders),
                "expert": expert,
                "causes": causes,
            },
            seed=config.seed,
        )
        for cohort in config.cohorts()
    }
    attempts: list[Attempt] = []
    findings: dict[int, Finding] = {}
    tracks: dict[int, Track] = {}
    fps, done = 0.0, 0
    with Progress(config.name, config.episodes, "episode", workers=executor.workers) as progress:
        for result in executor.run(jobs.values(), keep_going=True):
            cohort = jobs[result.key].kwargs["episodes"]
            if result.error is None:
                attempts += result.value.attempts
                findings |= result.value.findings
                tracks |= result.value.tracks
                fps = result.value.fps
            elif isinstance(result.error, LostError):
                attempts += [lost(e, c.name, f"crashed: {result.error}") for e in cohort for c in contenders]
            else:
                raise result.error
            done += len(cohort)
            progress.to(done, seconds=result.seconds)
    if not fps:
        raise PlaylearnError(f"every worker was lost; the last: {attempts[-1].reason}")
    return Watched(tuple(attempts), findings, tracks, fps)


def watch_cohort(
    suite: SuiteConfig, episodes: Sequence[int], contenders: Sequence[Contender], expert: Expert, causes: CausesConfig
) -> Watched:
    """What one worker does: the attempts of a contender and the expert, and why those of the former failed."""
    result = run_cohort(suite, episodes, contenders, expert, tracked=2)
    world = world_of(suite)
    mine = [attempt for attempt in result.attempts if attempt.policy == contenders[0].name]
    failed = {attempt.episode: attempt for attempt in ends(mine) if not attempt.success}
    own, shown = (result.tracks[contender.name] for contender in contenders)
    tracks = {episode: track for episode, track in own.items() if episode in failed}
    reached = {a.episode for a in ends([a for a in result.attempts if a.policy == expert.name]) if a.success}
    findings = {}
    for episode, track in tracks.items():
        attempt = failed[episode]
        if attempt.reason.startswith("crashed"):
            continue
        goal = np.array(attempt.goal_achieved, np.float32)
        judge = suite.kind.judge(world, attempt.task)
        content = np.array([judge(track.achieved[0], row, goal) for row in track.achieved])
        content[0] = False  # what is there before anything is done was not reached
        early = not attempt.reason.startswith("not reached")
        # What the expert did without a grasp does not fail as one; of a chain its last goal alone is known.
        model = shown.get(episode) if episode in reached else None
        grasping = True
        if model is not None and np.array_equal(model.goal_state, track.goal_state):
            grasping = by_grasp(world, model.achieved, model.body, goal, causes)
        findings[episode] = find_cause(world, track.achieved, track.body, goal, content, early, causes, grasping)
    return Watched(result.attempts, findings, tracks, world.spec.fps)


def _causes(failed: Sequence[Attempt], findings: Mapping[int, Finding], episodes: int) -> dict[str, Row]:
    """Cause -> its count, its share of the failures and of all episodes, how many stalled or still held it, by task."""
    named = {a.episode: findings[a.episode].cause if a.episode in findings else ENDED for a in failed}
    rows: dict[str, Row] = {}
    for cause in CAUSES:
        own = [attempt for attempt in failed if named[attempt.episode] == cause]
        stalled = [a for a in own if a.episode in findings and findings[a.episode].stalled_from is not None]
        rows[cause] = {
            "count": len(own),
            "share": len(own) / max(1, len(failed)),
            "ci95": list(wilson(len(own), len(failed))),
            "of_all": len(own) / episodes,
            "stalled": len(stalled),
            "holding": sum(a.episode in findings and findings[a.episode].holding for a in own),
            "tasks": dict(Counter(attempt.task for attempt in own).most_common()),
        }
    return dict(sorted(rows.items(), key=lambda item: int(item[1]["count"]), reverse=True))


def _failure(attempt: Attempt, findings: Mapping[int, Finding]) -> Row:
    row = {"episode": attempt.episode, "task": attempt.task, "made_by": attempt.made_by, "link": attempt.link}
    row |= {"steps": attempt.steps, "reason": attempt.reason}
    found = findings.get(attempt.episode)  # what crashed has none
    return row | ({"cause": ENDED} if found is None else asdict(found) | {"asked": list(found.asked)})


def _by_time(mine: Sequence[Attempt], its: Sequence[Attempt], fps: float) -> list[Row]:
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
        store = open_store(described(raw["store"]))
    except StoreError:
        return gone
    data = from_dict(DataConfig, raw["data"])
    if data.heldout_share <= 0:
        return none | {"note": "not measured: the run held no play out"}
    dataset: PlayDataset = data.build(store, "heldout", int(raw.get("seed", 0)))
    policy = Policy.load(run / "policy").eval()
    names = [store.meta(int(i)).skills for i in range(len(store))]
    errors: dict[str, list[float]] = {}
    drawn = np.random.default_rng(0).permutation(len(dataset))[:EXAMPLES]
    for part in np.array_split(drawn, max(1, len(drawn) // 256)):
        batch = dataset.recorded(0, part)
        off = (policy.act(batch, torch.Generator().manual_seed(0)) - batch.action)[:, 0].abs().mean(dim=1)
        for error, i, t in zip(off.tolist(), *dataset.where(part), strict=True):
            skill = store.array(int(i), "skill")[t]
            name = read_annotation(names[i][skill])[0] if names[i] else ""
            errors.setdefault(name, []).append(error)
    worst = sorted(errors, key=lambda name: float(np.mean(errors[name])), reverse=True)
    rows = {name: {"examples": len(errors[name]), "error": float(np.mean(errors[name]))} for name in worst}
    return none | {"skills": rows, "examples": len(drawn)}


def _strips(
    config: SuiteConfig, failed: Sequence[Attempt], watched: Watched, executor: Executor
) -> tuple[dict[str, list[tuple[str, bytes]]], str]:
    """Cause -> captions and film strips of its first failures; and why there are none, if there are none."""
    chosen: dict[int, Attempt] = {}
    for cause in CAUSES:
        own = [a for a in failed if a.episode in watched.findings and watched.findings[a.episode].cause == cause]
        firsts = list({attempt.task: attempt for attempt in reversed(own)}.values())[::-1]  # of as many tasks
        chosen |= {attempt.episode: attempt for attempt in firsts[:STRIPS]}
    jobs = [Job(e, draw_strip, {"suite": config, "track": watched.tracks[e]}) for e in chosen]
    shown: dict[str, list[tuple[str, bytes]]] = {}
    for result in executor.run(jobs, keep_going=True):
        if result.error is not None:
            return {}, f"No pictures: {result.error}"  # the numbers are worth having without
        attempt, finding = chosen[result.key], watched.findings[result.key]
        words = [f"episode {attempt.episode}", attempt.task, attempt.made_by, f"to move: {', '.join(finding.asked)}"]
        words += [] if finding.closest is None else [f"hand at best {100 * finding.closest:.0f} cm away"]
        words += [] if finding.off is None else [f"closed {100 * finding.off:.0f} cm off"]
        words += ["holds it"] if finding.holding else []
        words += [] if finding.stalled_from is None else [f"still from {finding.stalled_from:.1f} s on"]
        shown.setdefault(finding.cause, []).append((" · ".join(word for word in words if word), result.value))
    return {cause: sorted(shown[cause]) for cause in CAUSES if cause in shown}, ""


def draw_strip(suite: SuiteConfig, track: Track) -> bytes:
    """The film strip of an attempt, drawn by the worker that this runs in."""
    return strip(world_of(suite), track.states, track.goal_state, suite.camera)
