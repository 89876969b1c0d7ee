"""What every registered environment and its skill library must do; a new one is tested the day it is added."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import playlearn.envs
from playlearn.envs import OgbenchPlayConfig
from playlearn.episode import Array, Goal
from playlearn.errors import ActionError
from playlearn.oracles import PlayConfig, expert_for, play_policy_for
from playlearn.rollout import rollout
from playlearn.sim import EnvironmentConfig, Task
from tests.shares import often

KINDS = sorted(
    kind
    for kind, config in EnvironmentConfig.get_known_choices().items()
    if config.__module__.startswith(playlearn.envs.__name__)
)


PLAY_CONFIGS = {
    "ogbench_cube": OgbenchPlayConfig(),
    "ogbench_scene": OgbenchPlayConfig(),
}  # not by skills


@pytest.fixture(scope="module", params=KINDS)
def env(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param.startswith("ogbench"):
        pytest.importorskip("ogbench", reason="the extra `ogbench` is not installed")
    made = EnvironmentConfig.get_choice_class(request.param)().build()
    yield made
    made.close()


def wander(env: Any, seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        env.step(motion(env, *rng.uniform(-0.5, 0.5, 6), grip=rng.choice([-1.0, 1.0])))


def motion(env: Any, *moves: float, grip: float) -> Array:
    """An action; a tool has no grip, and OGBench's grips go from where the fingers are."""
    action = np.full(len(env.spec.action_names), grip)
    action[:6] = 0.0
    action[: len(moves)] = moves[: len(action)]
    return action


def begin(env: Any, task: Task, seed: int) -> tuple[Array, Array]:
    """A start state that suits the task, and its goal."""
    for draw in range(200):
        rng = np.random.default_rng([seed, draw])
        env.reset(1000 * seed + draw)
        task.arrange(env, rng)
        start = env.observe().achieved
        goal = np.asarray(task.command(start, rng), np.float32)
        if env.failure() is None and task.precondition(start) and not task.judge(start, start, goal):
            return start, goal
    pytest.fail(f"{task.name}: no start in 200 draws")


def test_its_spec_fits_its_observations(env: Any) -> None:
    env.reset(0)
    seen = env.observe()
    assert seen.state.shape == (len(env.spec.state_names),)
    assert seen.achieved.shape == (len(env.spec.achieved_names),)
    assert len(set(env.spec.achieved_names)) == len(env.spec.achieved_names)
    assert all("." in name for name in env.spec.achieved_names)  # of which object it speaks
    assert all(name == task.name for name, task in env.tasks.items())


def test_a_saved_state_goes_on_exactly_as_the_environment_did(env: Any) -> None:
    env.reset(1)
    wander(env, 1, 5)
    saved, twin = env.sim_state(), env.clone()
    wander(env, 2, 15)
    expected = env.sim_state(), env.observe()
    wander(twin, 2, 15)
    np.testing.assert_array_equal(twin.sim_state(), expected[0])
    env.set_state(saved)
    np.testing.assert_array_equal(env.sim_state(), saved)
    wander(env, 2, 15)
    np.testing.assert_array_equal(env.sim_state(), expected[0])  # bit for bit: nothing hides outside the state
    np.testing.assert_array_equal(env.observe().state, expected[1].state)
    np.testing.assert_array_equal(env.observe().achieved, expected[1].achieved)


@pytest.mark.slow
def test_two_that_are_built_alike_start_alike(env: Any) -> None:
    """A worker builds its own: nothing about the scene may be random."""
    other = env.config.build()
    for seed in (0, 1):
        env.reset(seed)
        wander(env, seed, 3)
        other.reset(seed)
        wander(other, seed, 3)
        np.testing.assert_array_equal(env.sim_state(), other.sim_state())
    env.reset(0)
    assert not np.array_equal(env.sim_state(), other.sim_state())


@pytest.mark.slow
def test_starts_are_sound_and_at_rest(env: Any) -> None:
    still = motion(env, grip=-1.0)
    for seed in range(8):
        env.reset(seed)
        start = env.observe().achieved
        assert env.failure() is None
        assert np.isfinite(start).all()
        for _ in range(10):
            env.step(still)
        np.testing.assert_allclose(env.observe().achieved, start, atol=0.01, err_msg=f"seed {seed}")


def test_bad_actions_are_refused_and_leave_it_alone(env: Any) -> None:
    env.reset(0)
    before = env.sim_state()
    size = len(env.spec.action_names)
    for bad in (np.full(size, np.nan), np.zeros(size - 1), np.full(size, 1.5)):
        with pytest.raises(ActionError):
            env.step(bad)
    np.testing.assert_array_equal(env.sim_state(), before)


def test_every_task_has_starts_that_are_not_won_and_goals_that_are(env: Any) -> None:
    for task in env.tasks.values():
        start, goal = begin(env, task, 2)
        assert env.reached(start, start), task.name
        assert not env.reached(start, goal), task.name
        assert task.judge(start, goal, goal), task.name


@pytest.mark.slow
def test_the_expert_does_every_task(env: Any) -> None:
    """Once each, of four tries at most; how often of hundreds, the suites say."""
    expert = expert_for(env)
    for task in env.tasks.values():
        assert often((_done(env, expert, task, seed) for seed in range(3, 7)), done=1), task.name


def _done(env: Any, expert: Any, task: Task, seed: int) -> bool:
    start, goal = begin(env, task, seed)

    def solved(_: int, seen: Any) -> bool:
        return task.judge(start, seen.achieved, goal)

    return rollout([env], expert, [Goal(goal)], seeds=[0], max_steps=250, stop=solved)[0].ended == "stopped"


def test_the_expert_rests_where_nothing_is_to_be_done(env: Any) -> None:
    env.reset(5)
    start = env.observe().achieved
    expert = expert_for(env)
    expert.reset([Goal(start)], [0])
    for _ in range(30):
        env.step(expert.act([env.observe()], [True])[0].action)
    assert env.reached(env.observe().achieved, start)
    np.testing.assert_allclose(env.observe().achieved, start, atol=0.02)


def test_the_expert_remembers_nothing(env: Any) -> None:
    """The same state and goal give the same action, whatever it was asked before."""
    env.reset(6)
    task = next(iter(env.tasks.values()))
    _, goal = begin(env, task, 6)
    fresh, used = expert_for(env), expert_for(env)
    used.reset([Goal(goal)], [0])
    for _ in range(25):
        action = used.act([env.observe()], [True])[0].action
        np.testing.assert_array_equal(action, fresh.decide(env.observe(), goal).action)
        assert np.abs(action).max() <= 1
        env.step(action)


@pytest.mark.slow
def test_play_changes_the_achieved_goal_and_follows_from_its_seed(env: Any) -> None:
    play_config = PLAY_CONFIGS.get(env.config.get_choice_name(type(env.config)), PlayConfig())

    def play(seed: int, steps: int) -> Any:
        env.reset(seed)
        return rollout([env], play_policy_for(env, play_config), [None], seeds=[seed], max_steps=steps)[0].episode

    def changed(episode: Any) -> bool:
        return not env.reached(episode.achieved[-1], episode.achieved[0]) or len(episode.meta.skills) > 2

    episode, again = play(7, 160), play(7, 50)
    np.testing.assert_array_equal(episode.action[:50], again.action)
    np.testing.assert_array_equal(episode.sim_state[:51], again.sim_state)
    assert changed(episode) or often((changed(play(seed, 160)) for seed in (8, 9, 10)), done=1, missed=3)


@pytest.mark.slow
def test_every_camera_sees_the_scene_change(env: Any) -> None:
    env.reset(8)
    before = env.observe(env.spec.cameras).images
    for _ in range(12):
        env.step(motion(env, 0.5, 0.3, -0.6, grip=1.0))
    for camera, image in env.observe(env.spec.cameras).images.items():
        assert image.std() > 10, f"{camera} sees nothing"
        assert np.abs(image.astype(int) - before[camera]).mean() > 1, f"{camera} does not see the arm move"
