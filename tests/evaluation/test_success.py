"""When an episode counts as a success, and when as a strict one."""

from collections.abc import Callable
from typing import Any

import pytest

from playlearn.errors import UsageError
from playlearn.evaluation import ExpertRecipe, SuiteConfig, TasksConfig
from playlearn.evaluation.worker import EpisodeResult, run_batch
from tests.fakes import PointConfig, PointEnv, point_expert

EXPERT = ExpertRecipe(point_expert)


def suite(success_hold_steps: int) -> SuiteConfig:
    return SuiteConfig(
        name="point_tasks",
        environment=PointConfig(),
        kind=TasksConfig(),
        episodes=3,
        max_steps=30,
        success_hold_steps=success_hold_steps,
        num_envs=1,
    )


def results(success_hold_steps: int) -> list[EpisodeResult]:
    """Of three episodes, one after the other."""
    made = suite(success_hold_steps)
    return [row for k in range(3) for row in run_batch(made, [k], [EXPERT], EXPERT).episode_results]


def content_two_of_three(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judges that are content at two steps of three, whatever they see, once the episode has begun."""

    def judge(*_: Any) -> Callable[..., bool]:
        asked = [0]

        def content(_start: Any, _achieved: Any, _goal: Any) -> bool:
            asked[0] += 1
            return asked[0] % 3 != 0

        return content

    monkeypatch.setattr(TasksConfig, "judge", judge)


def test_the_steps_of_a_success_are_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Content for two steps, again and again, is never content for three."""
    content_two_of_three(monkeypatch)
    assert [row.success for row in results(2)] == [True] * 3
    assert [row.success for row in results(3)] == [False] * 3


@pytest.mark.parametrize("all_there", [True, False])
def test_a_strict_success_has_everything_where_the_goal_shows_it(
    all_there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PointEnv, "reached", lambda *_: all_there)
    rows = results(3)
    assert all(row.success for row in rows)
    assert [row.strict for row in rows] == [all_there] * 3


def test_parked_goals_want_an_environment_that_can_park() -> None:
    environment = PointEnv(PointConfig())
    with pytest.raises(UsageError, match=r"kind\.parked: this environment cannot put its robot elsewhere"):
        TasksConfig(parked=True).setup(environment, EXPERT.build(environment), 0, 0, 50, ())
