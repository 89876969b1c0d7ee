"""Laws of several goals in a row, and of goals in which several things have changed."""

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
FAR = replace(CHAINS, name="point_far", kind=MultiChangeConfig(changes=(1, 2)))


@dataclass(frozen=True)
class Tiring:
    """Does as the expert does for `goals` goals of a chain, and then nothing."""

    goals: int
    name: str = "tiring"

    def cameras(self) -> tuple[str, ...]:
        return ()

    def describe(self) -> dict[str, Any]:
        return {}

    def build(self, environment: Environment) -> "TiringActor":
        return TiringActor(self.goals)


class TiringActor(PointExpert):
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


def episode_results(suite: SuiteConfig, contender: Any) -> list[EpisodeResult]:
    """Of all cohorts, each with an actor of its own."""
    return [a for cohort in suite.batches() for a in run_batch(suite, cohort, [contender], EXPERT).episode_results]


def test_each_goal_begins_where_the_one_before_ended() -> None:
    """Nothing is reset: the states join, and every goal differs from all that the chain had been shown before."""
    env = PointEnv(PointConfig())
    rows = episode_results(CHAINS, EXPERT)
    assert [(a.episode, a.link) for a in sorted(rows, key=lambda a: (a.episode, a.link))] == [
        (e, link) for e in range(8) for link in range(5)
    ]
    assert all(a.success and not a.already for a in rows)
    for e in range(8):
        mine = sorted((a for a in rows if a.episode == e), key=lambda a: a.link)
        shown = [mine[0].start_achieved, *(a.goal_achieved for a in mine)]
        for k, one in enumerate(shown):
            assert not any(env.reached(np.array(one), np.array(other)) for other in shown[:k])
        for before, after in pairwise(mine):
            assert before.final_achieved == after.start_achieved
        # the world has two kinds of task; the lamp can be lit once, and is before anything is done twice
        assert sum(a.task == "lamp_on" for a in mine) == 1
        assert "lamp_on" in {a.task for a in mine[:2]}


@pytest.mark.parametrize("goals", [0, 1, 3, 5])
def test_a_chain_is_as_long_as_the_goals_reached_in_a_row(goals: int) -> None:
    """Who does nothing after `goals` goals has chains of exactly that length, and no row after the failure."""
    rows = episode_results(CHAINS, Tiring(goals))
    result = summary(rows)
    assert result["chain"]["length_mean"] == goals
    assert result["chain"]["at_least"] == [1.0] * goals + [0.0] * (5 - goals)
    assert (result["episodes"], result["success_rate"]) == (8, float(goals == 5))
    assert len(rows) == 8 * min(goals + 1, 5)
    assert sum(result["chain"]["ended_by"].values()) == (0 if goals == 5 else 8)
    low, high = result["chain"]["length_ci95"]
    assert 0 <= low <= goals <= high <= 5


def test_the_numbers_of_chains() -> None:
    """Chains of 0, 1, 1 and 3 of 3: mean 1.25; at least one 3 of 4, two 1 of 4, three 1 of 4."""

    def row(episode: int, link: int, success: bool, task: str) -> EpisodeResult:
        return EpisodeResult("p", episode, task, success, success, 9, "", 0, 0, link=link, links=3, already=link == 2)

    rows = [row(0, 0, False, "a"), row(1, 0, True, "a"), row(1, 1, False, "b"), row(2, 0, True, "c")]
    rows += [row(2, 1, False, "b"), *(row(3, link, True, "abc"[link]) for link in range(3))]
    numbers = chain(rows)
    assert numbers["length_mean"] == 1.25
    assert numbers["at_least"] == [0.75, 0.25, 0.25]
    assert numbers["at_least_ci95"][0] == pytest.approx([0.301, 0.954], abs=1e-3)  # Wilson, 3 of 4
    assert numbers["ended_by"] == {"b": 2, "a": 1}
    assert numbers["already"] == pytest.approx(1 / 5)
    tasks = summary(rows)["tasks"]
    assert {name: (of["episodes"], of["success_rate"]) for name, of in tasks.items()} == {
        "a": (3, 2 / 3),
        "b": (3, 1 / 3),
        "c": (2, 1.0),
    }


def test_every_goal_has_a_budget_of_its_own_and_the_actor_forgets() -> None:
    """The expert needs more steps for five goals than one goal may take; it is reset for each."""
    rows = episode_results(CHAINS, EXPERT)
    assert max(a.steps for a in rows) <= CHAINS.max_steps
    assert max(sum(a.steps for a in rows if a.episode == e) for e in range(8)) > CHAINS.max_steps
    actor = TiringActor(1)

    class Given(Tiring):
        def build(self, environment: Environment) -> TiringActor:
            return actor

    run_batch(CHAINS, [0, 1, 2], [Given(1)], EXPERT)
    assert actor.seen == [3, 3], "two goals were attempted by each of three, the second in vain"


def test_a_crash_ends_the_chain_it_happens_in() -> None:
    """Goals reached before it stay reached; the crash is one failure for each chain that was still going."""

    class Crashing(TiringActor):
        def act(self, observations: Sequence[Observation], active: Sequence[bool]) -> list[Decision]:
            if self.left < 0:
                raise ZeroDivisionError("division by zero")
            return super().act(observations, active)

    class Crasher(Tiring):
        def build(self, environment: Environment) -> TiringActor:
            return Crashing(self.goals)

    result = summary(episode_results(CHAINS, Crasher(2)))
    assert (result["chain"]["length_mean"], result["crashed"]) == (2.0, 8)


def test_a_goal_that_is_there_already_counts_and_is_counted() -> None:
    """The judge of a chain is content where everything is as shown, whatever there was to do for it."""
    env = PointEnv(PointConfig())
    judge = ChainsConfig().judge(env, "move_puck")
    here = np.array([0.1, 0.2, 0.0])
    assert judge(here, here, here)
    assert not judge(here, here, np.array([0.1, 0.5, 0.0]))


def test_far_goals_show_every_change_and_have_longer() -> None:
    """Of two changes both are in the goal: the puck moved and the lamp lit; and there is time for each."""
    env = PointEnv(PointConfig())
    for e in range(8):
        setup = FAR.kind.setup(env, PointExpert(), e, 0, 60, ())
        changes = 1 + e % 2
        start, goal = setup.start_achieved, setup.goal.achieved
        moved = [np.linalg.norm(start[:2] - goal[:2]) > 0.06, start[2] != goal[2]]
        assert sum(moved) == changes == setup.made_by.count(",") + 1
        assert (setup.task, setup.max_steps) == (("1 change", 60), ("2 changes", 120))[e % 2]
        assert setup.then == ()


def test_far_goals_are_reached_by_the_expert_and_only_whole() -> None:
    """Judged on all that is shown, so success is strict success; half of it is none; an idler uses its whole budget."""
    result = summary(episode_results(FAR, EXPERT))
    assert result["success_rate"] == result["strict_rate"] == 1.0
    assert "chain" not in result
    assert {task: of["episodes"] for task, of in result["tasks"].items()} == {"1 change": 4, "2 changes": 4}
    judge = FAR.kind.judge(PointEnv(PointConfig()), "2 changes")
    goal = np.array([0.5, 0.5, 1.0])
    assert judge(np.zeros(3), goal, goal)
    assert not judge(np.zeros(3), np.array([0.5, 0.5, 0.0]), goal)
    idle = episode_results(FAR, Tiring(0))
    assert {(a.task, a.steps) for a in idle} == {("1 change", 60), ("2 changes", 120)}
    assert not any(a.success for a in idle)
    assert {a.reason for a in idle} == {"not reached in 60 steps", "not reached in 120 steps"}


@pytest.mark.parametrize("suite", [CHAINS, FAR])
def test_the_page_and_the_file_say_it(tmp_path: Path, suite: SuiteConfig) -> None:
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


def test_what_cannot_be_made_is_said() -> None:
    env = PointEnv(PointConfig())
    lamp = ChainsConfig(tasks=("lamp_on",), links=2)
    with pytest.raises(PlaylearnError, match=r"did not do 2 tasks in a row .* at most 1\. Ask for fewer `kind.links`"):
        lamp.setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(PlaylearnError, match="did not show 2 changes at once"):
        MultiChangeConfig(changes=(2,), tasks=("lamp_on",)).setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(UsageError, match="did you mean `lamp_on`"):
        ChainsConfig(tasks=("lamp_of",)).setup(env, PointExpert(), 0, 0, 60, ())
    with pytest.raises(UsageError, match=r"kind\.links must be 1 or more"):
        ChainsConfig(links=0)
    with pytest.raises(UsageError, match=r"kind\.changes must be numbers of 1 or more"):
        MultiChangeConfig(changes=())


@pytest.mark.parametrize(
    ("name", "kind"), [("playtable_chains", ChainsConfig), ("playtable_multi_change", MultiChangeConfig)]
)
def test_the_suites_that_come_along_are_sound(name: str, kind: type) -> None:
    suite = load_suite(Path(__file__).parents[2] / "eval" / "suites" / f"{name}.yaml")
    assert suite.name == name
    assert isinstance(suite.kind, kind)
