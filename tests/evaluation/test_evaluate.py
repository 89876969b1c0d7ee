"""Laws of evaluation, in an environment in which everything takes milliseconds."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from playlearn.config import save_config, to_dict
from playlearn.episode import Decision, Observation
from playlearn.errors import CheckpointError, PlaylearnError, UsageError
from playlearn.evaluation import (
    ExpertRecipe,
    RandomRecipe,
    SuiteConfig,
    evaluate,
)
from playlearn.evaluation.job import _evaluate
from playlearn.evaluation.results import curve, summary
from playlearn.evaluation.worker import BatchResult, run_batch
from playlearn.executor import InProcessExecutor, Job, LostError, Result
from playlearn.rollout import Actor
from playlearn.sim.environment import Environment
from tests.evaluation.parts import EXPERT, SUITE, write
from tests.fakes import PointConfig, PointEnv, PointExpert, point_expert

torch.set_num_threads(1)


def fumbling(_environment: Environment) -> PointExpert:
    return PointExpert(fumble=0.5)


def useless(_environment: Environment) -> PointExpert:
    return PointExpert(fumble=1.0)


def evaluated(suite: SuiteConfig, recipes: Sequence[Any], expert: ExpertRecipe = EXPERT) -> list[BatchResult]:
    return [run_batch(suite, batch, recipes, expert) for batch in suite.batches()]


def test_the_expert_succeeds_and_the_random_policy_does_not(tmp_path: Path) -> None:
    """A suite can be solved, and not by random actions; with every output file."""
    out = tmp_path / "out"
    results = evaluate(write(SUITE, tmp_path), policy="expert", goal="state", out=out, workers=0, expert=point_expert)
    assert results["success_rate"] == 1.0
    assert results["references"]["random"]["success_rate"] < 0.5
    assert results["references"]["expert"]["success_rate"] == results["success_rate"]
    assert json.loads((out / "results.json").read_text()) == results
    nothing: dict[str, list[str]] = {"training": [], "relabeling": [], "goal": []}
    assert results["privileged"] == {**nothing, "training": ["simulator state"]}
    assert results["references"]["random"]["privileged"] == nothing
    page = (out / "report.html").read_text()
    assert "<td>training: simulator state</td>" in page
    assert "<td>none</td>" in page
    assert results["achieved_names"] == ["puck.x", "puck.y", "lamp"]
    assert {name: row["episodes"] for name, row in results["tasks"].items()} == {"move_puck": 5, "lamp_on": 5}
    assert (results["suite"], results["goal_modality"], results["episodes"]) == ("point_tasks", "state", 10)
    assert results["renderer"] == "numpy"
    assert results["ci95"] == pytest.approx([0.722, 1.0], abs=1e-3)  # Wilson, 10 of 10: 10 / (10 + 1.96^2)
    rows = pq.read_table(out / "episodes.parquet").to_pylist()
    assert [(row["policy"], row["episode"]) for row in rows] == [
        (p, e) for p in ("expert", "random") for e in range(10)
    ]
    assert sum(row["success"] for row in rows if row["policy"] == "expert") == 10


@pytest.mark.slow
def test_the_same_for_any_number_of_workers(tmp_path: Path, image_run: Path) -> None:
    """Batches are fixed by the suite, so two processes and none write the same rows, bit for bit."""
    suite = write(replace(SUITE, episodes=6, max_steps=20), tmp_path)
    tables, rates = [], []
    for workers in (0, 2):
        out = tmp_path / str(workers)
        rates.append(evaluate(suite, run=image_run, out=out, workers=workers, expert=point_expert))
        tables.append((out / "episodes.parquet").read_bytes())
    assert tables[0] == tables[1]
    assert {**rates[0], "seconds": 0} == {**rates[1], "seconds": 0}


def test_goals_are_what_was_really_reached() -> None:
    """From the recorded states: the goal state shows the goal, the judge accepts it, and not at the start."""
    env = PointEnv(PointConfig())
    for result in evaluated(SUITE, [RandomRecipe()]):
        for episode_result in result.episode_results:
            env.set_state(np.array(episode_result.start_sim_state))
            start = env.observe().achieved
            env.set_state(np.array(episode_result.goal_sim_state))
            goal = env.observe().achieved
            np.testing.assert_array_equal(start, np.array(episode_result.start_achieved, np.float32))
            np.testing.assert_array_equal(goal, np.array(episode_result.goal_achieved, np.float32))
            judge = env.tasks[episode_result.task].judge
            assert judge(start, goal, goal)
            assert not judge(start, start, goal)
            assert env.tasks[episode_result.task].precondition(start)


def test_an_episode_is_independent_of_the_others() -> None:
    """Episode 5 in its batch, and by itself with fewer actors."""
    together = {
        a.policy: a
        for result in evaluated(SUITE, [EXPERT, RandomRecipe()])
        for a in result.episode_results
        if a.episode == 5
    }
    separately = run_batch(SUITE, [5], [RandomRecipe()], EXPERT).episode_results
    assert separately == (together["random"],)


def test_where_the_expert_fumbles_another_start_is_drawn() -> None:
    """An expert that idles every other time: about one redraw an episode, and every goal still reached."""
    suite = replace(SUITE, episodes=24)
    episode_results = [
        a for result in evaluated(suite, [EXPERT], ExpertRecipe(fumbling)) for a in result.episode_results
    ]
    assert 6 < sum(episode_result.redraws for episode_result in episode_results) < 96
    assert all(episode_result.success for episode_result in episode_results)


def test_a_task_that_the_expert_cannot_do_is_named() -> None:
    with pytest.raises(PlaylearnError, match=r"did not do task 'lamp_on' in 20 draws of episode 1 .*Leave it out"):
        run_batch(SUITE, [1], [RandomRecipe()], ExpertRecipe(useless))


def test_success_must_hold() -> None:
    """The expert stays where it arrived, so holding for 4 steps takes it 3 more than holding for 1."""
    short, long = (
        [a for result in evaluated(replace(SUITE, success_hold_steps=hold), [EXPERT]) for a in result.episode_results]
        for hold in (1, 4)
    )
    assert [b.steps - a.steps for a, b in zip(short, long, strict=True)] == [3] * 10
    suite = replace(SUITE, max_steps=20, success_hold_steps=20)
    assert not any(
        a.success for result in evaluated(suite, [EXPERT]) for a in result.episode_results if a.start_sim_state
    )


@dataclass(frozen=True)
class Crasher:
    """Fails in the middle of an episode."""

    name: str = "crasher"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def describe(self) -> dict[str, Any]:
        return {}

    def build(self, environment: Environment) -> Actor:
        return _CrashingActor()


class _CrashingActor(PointExpert):
    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        if observations[0].time > 0.25:
            raise ZeroDivisionError("division by zero")
        return super().act(observations, active)


def test_a_crashed_rollout_is_a_failure_with_its_reason() -> None:
    """It is counted, and later actors are evaluated as usual."""
    results = evaluated(SUITE, [Crasher(), EXPERT])
    crashed = [a for result in results for a in result.episode_results if a.policy == "crasher"]
    assert [a.episode for a in crashed] == list(range(10))
    assert {a.reason for a in crashed} == {"crashed: ZeroDivisionError: division by zero"}
    numbers = summary(crashed)
    assert (numbers["episodes"], numbers["crashed"], numbers["success_rate"]) == (10, 10, 0.0)
    assert all(a.success for result in results for a in result.episode_results if a.policy == "expert")


class LosesTheFirst(InProcessExecutor):
    """An executor whose first job's worker dies again and again."""

    def run(self, jobs: Iterable[Job], *, keep_going: bool = False) -> Iterator[Result]:
        first, *others = jobs
        yield Result(first.key, None, 0.0, tries=3, error=LostError(first, 3, "was killed"))
        yield from super().run(others, keep_going=keep_going)


def test_episodes_of_a_lost_worker_are_failures() -> None:
    gathered = _evaluate(SUITE, [EXPERT, RandomRecipe()], EXPERT, LosesTheFirst())
    assert sorted((a.episode, a.policy) for a in gathered.episode_results) == sorted(
        (e, policy) for e in range(10) for policy in ("expert", "random")
    )
    mine = [a for a in gathered.episode_results if a.policy == "expert"]
    assert sorted(a.episode for a in mine if not a.success) == [0, 1, 2, 3]
    assert summary(mine)["crashed"] == 4


def test_the_curve_ends_at_the_success_rate() -> None:
    episode_results = [a for result in evaluated(SUITE, [EXPERT]) for a in result.episode_results]
    rates_by_step = curve(episode_results, SUITE.max_steps)
    assert len(rates_by_step) == SUITE.max_steps + 1
    assert rates_by_step[0] == 0.0
    assert rates_by_step == sorted(rates_by_step)
    assert rates_by_step[-1] == summary(episode_results)["success_rate"]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"goal": "picture"}, UsageError, "--goal is 'picture'"),
        ({"goal": "image"}, UsageError, "reads its goal from a state: use --goal state"),
        ({"policy": "expert"}, UsageError, "either --run RUN"),
        ({"run": None}, UsageError, "either --run RUN"),
        ({"run": None, "policy": "exprt"}, UsageError, "did you mean `expert`"),
        ({"run": Path("nowhere")}, CheckpointError, "there is no run at nowhere; make one with"),
        ({"suite": Path("nowhere.yaml")}, UsageError, r"nowhere\.yaml"),
        ({"episodes": 0}, UsageError, "episodes must be 1 or more"),
        ({"workers": -1}, UsageError, "workers is -1"),
        ({"overrides": ("--kind.tasks", "[lamp_of]")}, UsageError, "did you mean `lamp_on`"),
        ({"overrides": ("--max_step", "9")}, UsageError, "max_steps"),
    ],
)
def test_mistakes_end_before_anything_is_written(
    tmp_path: Path, run: Path, change: dict[str, Any], error: type[PlaylearnError], message: str
) -> None:
    out = tmp_path / "out"
    arguments: dict[str, Any] = {"suite": write(SUITE, tmp_path), "run": run, "goal": "state", "out": out, "workers": 0}
    with pytest.raises(error, match=message):
        evaluate(**{**arguments, "expert": point_expert, **change})
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize("name", ["playtable_tasks", "playtable_val"])
def test_the_suites_that_come_along_are_sound(name: str) -> None:
    from playlearn.evaluation import load_suite

    suite = load_suite(Path(__file__).parents[2] / "eval" / "suites" / f"{name}.yaml")
    assert suite.name == name
    assert to_dict(suite)["environment"]["type"] == "playtable"


def test_a_suite_is_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    from playlearn.evaluation import load_suite

    save_config(SUITE, tmp_path / "suite.yaml")
    assert load_suite(tmp_path / "suite.yaml") == SUITE
