"""Laws of chains of goals, and of goals in which several objects have changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from playlearn.config import to_dict
from playlearn.episode import Decision, Goal, Observation
from playlearn.errors import PlaylearnError, UsageError
from playlearn.evaluation import ChainsConfig, ExpertRecipe, MultiChangeConfig, SuiteConfig, evaluate, load_suite
from playlearn.evaluation.results import chain, summary
from playlearn.evaluation.worker import EpisodeResult, run_batch
from playlearn.sim.environment import Environment
from tests.fakes import PointConfig, PointEnv, PointExpert, point_expert

EXPERT = ExpertRecipe(point_expert)
CHAINS = SuiteConfig(
    name="point_chains",
    environment=PointConfig(),
    kind=ChainsConfig(),
    episodes=8,
    max_steps=60,
    success_hold_steps=3,
    num_envs=4,
)
MULTI_CHANGE = replace(CHAINS, name="point_multi_change", kind=MultiChangeConfig(changes=(1, 2)))


@dataclass(frozen=True)
class StopsAfter:
    """Acts like the expert for `goals` goals of a chain, then not at all."""

    goals: int
    name: str = "stops"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def describe(self) -> dict[str, Any]:
        return {}

    def build(self, environment: Environment) -> "StoppingActor":
        return StoppingActor(self.goals)


class StoppingActor(PointExpert):
    def __init__(self, goals: int) -> None:
        super().__init__()
        self.left = goals
        self.seen: list[int] = []

    def reset(self, goals: Sequence[Goal | None], seeds: Sequence[int]) -> None:
        super().reset(goals, seeds)
        self.seen.append(len(goals))
        self.left -= 1

    def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
        if self.left < 0:
            return [Decision(np.zeros(3, np.float32)) for _ in observations]
        return super().act(observations, active)


def episode_results(suite: SuiteConfig, recipe: Any) -> list[EpisodeResult]:
    """Of all batches, each with its own actor."""
    return [row for batch in suite.batches() for row in run_batch(suite, batch, [recipe], EXPERT).episode_results]


def test_each_goal_begins_where_the_one_before_ended() -> None:
    """Nothing is reset: each goal starts where the previous one ended, and every goal differs from all earlier ones."""
    env = PointEnv(PointConfig())
    rows = episode_results(CHAINS, EXPERT)
    assert [(row.episode, row.goal_index) for row in sorted(rows, key=lambda row: (row.episode, row.goal_index))] == [
        (e, goal_index) for e in range(8) for goal_index in range(5)
    ]
    assert all(row.success and not row.solved_at_start for row in rows)
    for e in range(8):
        chain_rows = sorted((row for row in rows if row.episode == e), key=lambda row: row.goal_index)
        shown = [chain_rows[0].start_achieved, *(row.goal_achieved for row in chain_rows)]
        for k, one in enumerate(shown):
            assert not any(env.reached(np.array(one), np.array(other)) for other in shown[:k])
        for before, after in pairwise(chain_rows):
            assert before.final_achieved == after.start_achieved
        # the environment has two kinds of task; the lamp can be lit once, and is before any kind is repeated
        assert sum(row.task == "lamp_on" for row in chain_rows) == 1
        assert "lamp_on" in {row.task for row in chain_rows[:2]}


@pytest.mark.parametrize("goals", [0, 1, 3, 5])
def test_a_chain_is_as_long_as_the_goals_reached_in_a_row(goals: int) -> None:
    """An actor that stops after `goals` goals has chains of exactly that length, and no row after the failure."""
    rows = episode_results(CHAINS, StopsAfter(goals))
    result = summary(rows)
    assert result["chain"]["length_mean"] == goals
    assert result["chain"]["at_least"] == [1.0] * goals + [0.0] * (5 - goals)
    assert (result["episodes"], result["success_rate"]) == (8, float(goals == 5))
    assert len(rows) == 8 * min(goals + 1, 5)
    assert sum(result["chain"]["ended_by"].values()) == (0 if goals == 5 else 8)
    low, high = result["chain"]["length_ci95"]
    assert 0 <= low <= goals <= high <= 5


def test_chain_statistics() -> None:
    """Chains of 0, 1, 1 and 3 of 3: mean 1.25; at least one 3 of 4, two 1 of 4, three 1 of 4."""

    def row(episode: int, goal_index: int, success: bool, task: str) -> EpisodeResult:
        return EpisodeResult(
            "p",
            episode,
            task,
            success,
            success,
            9,
            "",
            0,
            0,
            goal_index=goal_index,
            num_goals=3,
            solved_at_start=goal_index == 2,
        )

    rows = [row(0, 0, False, "a"), row(1, 0, True, "a"), row(1, 1, False, "b"), row(2, 0, True, "c")]
    rows += [row(2, 1, False, "b"), *(row(3, goal_index, True, "abc"[goal_index]) for goal_index in range(3))]
    numbers = chain(rows)
    assert numbers["length_mean"] == 1.25
    assert numbers["at_least"] == [0.75, 0.25, 0.25]
    assert numbers["at_least_ci95"][0] == pytest.approx([0.301, 0.954], abs=1e-3)  # Wilson, 3 of 4
    assert numbers["ended_by"] == {"b": 2, "a": 1}
    assert numbers["solved_at_start"] == pytest.approx(1 / 5)
    tasks = summary(rows)["tasks"]
    assert {name: (of["episodes"], of["success_rate"]) for name, of in tasks.items()} == {
        "a": (3, 2 / 3),
        "b": (3, 1 / 3),
        "c": (2, 1.0),
    }


def test_every_goal_has_its_own_budget_and_the_actor_is_reset() -> None:
    """The expert needs more steps for five goals than one goal may take; it is reset for each."""
    rows = episode_results(CHAINS, EXPERT)
    assert max(row.steps for row in rows) <= CHAINS.max_steps
    assert max(sum(row.steps for row in rows if row.episode == e) for e in range(8)) > CHAINS.max_steps
    actor = StoppingActor(1)

    class Given(StopsAfter):
        def build(self, environment: Environment) -> StoppingActor:
            return actor

    run_batch(CHAINS, [0, 1, 2], [Given(1)], EXPERT)
    assert actor.seen == [3, 3], "three episodes attempted two goals each, and failed at the second"


def test_a_crash_ends_the_chain_it_happens_in() -> None:
    """Goals reached before it stay reached; the crash is one failure for each chain that was still going."""

    class Crashing(StoppingActor):
        def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
            if self.left < 0:
                raise ZeroDivisionError("division by zero")
            return super().act(observations, active)

    class Crasher(StopsAfter):
        def build(self, environment: Environment) -> StoppingActor:
            return Crashing(self.goals)

    result = summary(episode_results(CHAINS, Crasher(2)))
    assert (result["chain"]["length_mean"], result["crashed"]) == (2.0, 8)


def test_a_goal_that_is_satisfied_at_the_start_is_reached() -> None:
    """The judge of a chain is satisfied if everything is as shown, whatever had to be done for it."""
    env = PointEnv(PointConfig())
    judge = ChainsConfig().judge(env, "move_puck")
    here = np.array([0.1, 0.2, 0.0])
    assert judge(here, here, here)
    assert not judge(here, here, np.array([0.1, 0.5, 0.0]))


def test_multi_change_goals_show_every_change_and_have_larger_budgets() -> None:
    """Of two changes both are in the goal: the puck moved and the lamp lit; and there is time for each."""
    env = PointEnv(PointConfig())
    for e in range(8):
        episode = MULTI_CHANGE.kind.setup(env, PointExpert(), e, 0, 60, ())
        changes = 1 + e % 2
        start, goal = episode.start_achieved, episode.goal.achieved
        moved = [np.linalg.norm(start[:2] - goal[:2]) > 0.06, start[2] != goal[2]]
        assert sum(moved) == changes == episode.expert_tasks.count(",") + 1
        assert (episode.task, episode.max_steps) == (("1 change", 60), ("2 changes", 120))[e % 2]
        assert episode.next_goals == ()


def test_multi_change_goals_are_reached_by_the_expert_and_only_completely() -> None:
    """Success is strict success; half of a goal is none; an idle actor uses its whole budget."""
    result = summary(episode_results(MULTI_CHANGE, EXPERT))
    assert result["success_rate"] == result["strict_rate"] == 1.0
    assert "chain" not in result
    assert {task: of["episodes"] for task, of in result["tasks"].items()} == {"1 change": 4, "2 changes": 4}
    judge = MULTI_CHANGE.kind.judge(PointEnv(PointConfig()), "2 changes")
    goal = np.array([0.5, 0.5, 1.0])
    assert judge(np.zeros(3), goal, goal)
    assert not judge(np.zeros(3), np.array([0.5, 0.5, 0.0]), goal)
    idle = episode_results(MULTI_CHANGE, StopsAfter(0))
    assert {(row.task, row.steps) for row in idle} == {("1 change", 60), ("2 changes", 120)}
    assert not any(row.success for row in idle)
    assert {row.reason for row in idle} == {"not reached in 60 steps", "not reached in 120 steps"}


@pytest.mark.parametrize("suite", [CHAINS, MULTI_CHANGE])
def test_page_and_file_have_the_chain(tmp_path: Path, suite: SuiteConfig) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(yaml.safe_dump(to_dict(replace(suite, episodes=4))))
    out = tmp_path / "out"
    results = evaluate(path, policy="expert", goal="state", out=out, workers=0, expert=point_expert)
    page = (out / "report.html").read_text()
    assert ('id="chain"' in page) == ("chain" in results) == (suite is CHAINS)
    if suite is CHAINS:
        assert results["chain"]["length_mean"] == 5.0
        assert results["references"]["random"]["chain"]["length_mean"] < 1
        assert "5.00" in page


def test_an_impossible_suite_is_refused() -> None:
    env = PointEnv(PointConfig())
    lamp = ChainsConfig(tasks=("lamp_on",), num_goals=2)
    with pytest.raises(
        PlaylearnError, match=r"did not do 2 tasks in a row .* at most 1\. Ask for fewer `kind.num_goals`"
    ):
        lamp.setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(PlaylearnError, match="did not show 2 changes at once"):
        MultiChangeConfig(changes=(2,), tasks=("lamp_on",)).setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(UsageError, match="did you mean `lamp_on`"):
        ChainsConfig(tasks=("lamp_of",)).setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(UsageError, match=r"kind\.num_goals must be 1 or more"):
        ChainsConfig(num_goals=0)
    with pytest.raises(UsageError, match=r"kind\.changes must be numbers of 1 or more"):
        MultiChangeConfig(changes=())


@pytest.mark.parametrize(
    ("name", "kind"), [("playtable_chains", ChainsConfig), ("playtable_multi_change", MultiChangeConfig)]
)
def test_the_suites_that_come_along_are_sound(name: str, kind: type) -> None:
    suite = load_suite(Path(__file__).parents[2] / "eval" / "suites" / f"{name}.yaml")
    assert suite.name == name
    assert isinstance(suite.kind, kind)
