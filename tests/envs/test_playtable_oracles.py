"""The scripted actors: the expert reaches its goals, play is what its config says."""

from collections.abc import Callable

import numpy as np
import pytest

from playlearn.envs import PlayTableConfig
from playlearn.envs.playtable import scene
from playlearn.envs.playtable.env import PlayTableEnv
from playlearn.envs.playtable.layout import LED, block
from playlearn.episode import Episode, Goal
from playlearn.oracles import PlayConfig, expert_for, play_policy_for
from playlearn.oracles.end_effector import EndEffector
from playlearn.rollout import rollout
from tests.shares import often


@pytest.fixture(scope="module")
def env() -> PlayTableEnv:
    return PlayTableConfig().build()


def play(env: PlayTableEnv, seed: int, steps: int, config: PlayConfig) -> Episode:
    env.reset(seed)
    episode = rollout([env], play_policy_for(env, config), [None], seeds=[seed], max_steps=steps)[0].episode
    assert episode is not None
    return episode


def begin(env: PlayTableEnv, name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A start of the task, and the goal that it commands there."""
    task = env.tasks[name]
    for draw in range(20):
        rng = np.random.default_rng([seed, draw])
        env.reset(int(rng.integers(2**31)))
        task.arrange(env, rng)
        start = env.achieved()
        if env.failure() is None and task.precondition(start):
            return start, task.command(start, rng)
    pytest.fail(f"{name}: no start in 20 draws")


def solves(env: PlayTableEnv, goal: np.ndarray, steps: int, solved: Callable[[np.ndarray], bool]) -> bool:
    """Whether the expert brings the table to where `solved` holds for a quarter of a second."""
    expert = expert_for(env)
    expert.reset([Goal(goal)], [0])
    held = 0
    for _ in range(steps):
        env.step(expert.act([env.observe()], [True])[0].action)
        held = held + 1 if solved(env.achieved()) else 0
        if held == 5:
            return True
    return False


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "rotate_pink_right",
        "rotate_red_left",
        "push_blue_right",
        "push_red_left",
        "move_slider_left",
        "move_slider_right",
        "open_drawer",
        "close_drawer",
        "lift_red_table",
        "lift_blue_slider",
        "lift_pink_drawer",
        "place_in_slider",
        "place_in_drawer",
        "push_into_drawer",
        "stack_block",
        "unstack_block",
        "turn_on_lightbulb",
        "turn_off_lightbulb",
        "turn_on_led",
        "turn_off_led",
    ],
)
def test_the_expert_does_every_kind_of_task(env: PlayTableEnv, name: str) -> None:
    """At one start of four at the least; whole suites say how often over hundreds."""
    task = env.tasks[name]

    def done(seed: int) -> bool:
        start, goal = begin(env, name, seed)
        return solves(env, goal, 200, lambda now: task.judge(start, now, goal))

    assert often((done(seed) for seed in range(4)), done=1)


def anything(env: PlayTableEnv, seed: int) -> np.ndarray:
    """A goal that differs from the start in everything: some 400 steps, of which a block takes 70."""
    env.reset(2000 + seed)
    goal = env.achieved()
    env.reset(1000 + seed)
    return goal


def arranged(env: PlayTableEnv, seed: int) -> np.ndarray:
    """Drawer and slider at 0, the blocks in a row on the deck."""
    env.reset(seed)
    env.slide_drawer(0.0)
    env.slide_slider(0.0)
    for i in range(3):
        env.lay(i, (0.06, -0.13 + 0.11 * i), 0.2)
    env.refresh()
    return env.achieved()


def two_swapped(env: PlayTableEnv, seed: int) -> np.ndarray:
    """Each stands where the other is to go: one has to be laid aside first."""
    goal = arranged(env, seed)
    block(goal, 0)[:], block(goal, 1)[:] = block(env.achieved(), 1), block(env.achieved(), 0)
    return goal


def out_of_the_drawer(env: PlayTableEnv, seed: int) -> np.ndarray:
    """What is shut in the drawer is to lie on the deck, with all shut as before."""
    goal = arranged(env, seed)
    env.slide_drawer(0.1)
    env.stow(0, np.random.default_rng(seed))
    env.slide_drawer(0.0)
    env.refresh()
    return goal


def out_of_the_bay(env: PlayTableEnv, seed: int) -> np.ndarray:
    """What lies under the slider is to lie on the deck, with the slider where it was."""
    goal = arranged(env, seed)
    env.lay(0, (scene.BAY_CENTER[0], scene.SLIDER_Y), np.pi / 2)
    env.refresh()
    return goal


def lower_of_a_pile(env: PlayTableEnv, seed: int) -> np.ndarray:
    """It is to go elsewhere, and what is on it too."""
    goal = arranged(env, seed)
    block(goal, 0)[:2] = 0.1, 0.05
    block(goal, 2)[:2] = 0.0, 0.09
    env.stack(1, 0, np.random.default_rng(seed))
    env.refresh()
    return goal


# Each with the steps that are enough for it.
FAR = {anything: 700, two_swapped: 350, out_of_the_drawer: 450, out_of_the_bay: 450, lower_of_a_pile: 400}


def brought(env: PlayTableEnv, start: Callable[[PlayTableEnv, int], np.ndarray], seed: int) -> bool:
    """Whether the expert makes what it is shown of that start."""
    goal = start(env, seed)
    assert not env.reached(env.achieved(), goal)
    return solves(env, goal, FAR[start], lambda now: env.reached(now, goal))


@pytest.mark.slow
@pytest.mark.parametrize(
    "start", [pytest.param(start, marks=[] if start is two_swapped else [pytest.mark.slow]) for start in FAR]
)
def test_the_expert_goes_from_any_state_to_any_other(
    env: PlayTableEnv, start: Callable[[PlayTableEnv, int], np.ndarray]
) -> None:
    assert often(brought(env, start, seed) for seed in range(5))


def pressed_twice(env: PlayTableEnv, seed: int) -> bool:
    """Pressed once, the lamp will not change again while the button is held down: it has to be let up first."""
    lit = arranged(env, seed)
    lit[LED] = 1 - lit[LED]
    if not solves(env, lit, 150, lambda now: bool(now[LED] == lit[LED])):
        return False
    for _ in range(3):
        env.step(np.array([0, 0, -0.6, 0, 0, 0, 1.0]))
    back = env.achieved()
    back[LED] = 1 - back[LED]
    return solves(env, back, 150, lambda now: bool(now[LED] == back[LED]))


def test_the_expert_lets_a_pressed_button_up_before_it_presses_again(env: PlayTableEnv) -> None:
    assert often(pressed_twice(env, seed) for seed in range(1, 6))


def test_the_expert_rests_where_nothing_is_to_be_done(env: PlayTableEnv) -> None:
    env.reset(0)
    start = env.achieved()
    expert = expert_for(env)
    expert.reset([Goal(start)], [0])
    for _ in range(30):
        env.step(expert.act([env.observe()], [True])[0].action)
    np.testing.assert_allclose(env.achieved(), start, atol=2e-3)


@pytest.mark.slow
def test_play_is_the_same_for_the_same_seed(env: PlayTableEnv) -> None:
    first, again = play(env, 3, 60, PlayConfig()), play(env, 3, 60, PlayConfig())
    np.testing.assert_array_equal(first.action, again.action)
    np.testing.assert_array_equal(first.sim_state, again.sim_state)


def test_play_without_noise_or_mistakes_executes_its_labels(env: PlayTableEnv) -> None:
    tidy = PlayConfig(noise=0.0, pause=0.0, mistake=0.0, slip=0.0)
    episode = play(env, 4, 80, tidy)
    np.testing.assert_array_equal(episode.action, episode.expert_action)


def test_mistakes_change_what_is_done_and_not_what_was_meant(env: PlayTableEnv) -> None:
    clumsy = play(env, 4, 40, PlayConfig(noise=0.0, pause=0.0, mistake=1.0, slip=0.0))
    strayed = np.abs(clumsy.action - clumsy.expert_action).max(axis=1)
    assert strayed[:20].max() > 0.3  # acts on a place 3 cm or more from where objects are
    seen = clumsy.expert_action
    assert np.isfinite(seen).all()
    assert np.abs(seen).max() <= 1


@pytest.mark.slow
def test_play_changes_the_table_in_many_ways(env: PlayTableEnv) -> None:
    """Until four kinds of skill were tried, a block was moved and the gripper moved about: two tries suffice."""
    skills, moved, about = set(), 0.0, 0.0
    for seed in range(10):
        episode = play(env, 10 + seed, 300, PlayConfig())
        skills |= {name.split("_")[0] for name in episode.meta.skills}
        moved = max(moved, float(np.ptp(episode.achieved[:, :2], axis=0).max()))
        about = max(about, float(np.ptp(episode.state[:, :3], axis=0).max()))
        if len(skills) >= 4 and moved > 0.05 and about > 0.15:
            return
    pytest.fail(f"{len(skills)} skills, a block moved by {moved:.2f} m, the hand by {about:.2f} m")


@pytest.mark.parametrize("yaw", [0.3, np.pi / 2, 2.5])
def test_a_motion_points_at_its_target_and_never_beyond_full_speed(yaw: float) -> None:
    down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # gripper down, fingers along y
    hand = EndEffector(np.array([0.0, 0.0, 1.0]), down, 0.08)
    action = hand.move(np.array([0.3, 0.4, 1.0]), yaw, -1.0)
    np.testing.assert_allclose(action[:3], [0.6, 0.8, 0.0], atol=1e-9)  # 0.5 m away: full speed, straight
    assert np.sign(action[5].round(6)) == np.sign(round(yaw - np.pi / 2, 6))
    assert np.abs(action[3:5]).max() < 1e-9  # it stays upright
