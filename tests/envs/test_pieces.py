"""Laws of the environments of pieces: Lift and Stack are robosuite's own, any arrangement can be made of any other."""

from collections.abc import Callable

import numpy as np
import pytest

from playlearn.envs import LiftConfig, StackConfig
from playlearn.envs.pieces import PiecesEnv
from playlearn.envs.pieces.env import yaw_code
from playlearn.episode import Array, Goal
from playlearn.oracles import expert_for
from playlearn.rollout import rollout
from tests.shares import often


@pytest.fixture(scope="module")
def stack() -> PiecesEnv:
    return StackConfig().build()


def robosuite_success(env: PiecesEnv) -> bool:
    """What robosuite's own environment calls success in the state that the environment is in."""
    their_env = env.robosuite
    their_env.sim.data.qpos[:] = env.data.qpos
    their_env.sim.forward()
    return bool(their_env._check_success())


def reach(env: PiecesEnv, goal: Array, steps: int = 400) -> bool:
    def there(_: int, seen: object) -> bool:
        return env.reached(env.achieved(), goal)

    return rollout([env], expert_for(env), [Goal(goal)], seeds=[0], max_steps=steps, stop=there)[0].ended == "stopped"


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.822, 0.835, 0.839, 0.845, 0.9])
def test_lifted_is_what_robosuite_calls_lifted(height: float) -> None:
    env = LiftConfig().build()
    env.reset(0)
    start = env.achieved()
    env.put("cube_joint0", [0.0, 0.0, height], [1, 0, 0, 0])
    env._refresh()
    assert env.tasks["lift_cube"].judge(start, env.achieved(), start) == robosuite_success(env)


def test_stacked_is_what_robosuite_calls_stacked(stack: PiecesEnv) -> None:
    a, b = stack.pieces.all
    task, agreed = stack.tasks["stack_cubeA"], set()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        stack.reset(seed)
        if seed % 2:
            stack.stack(a, b, rng)
            stack.refresh()
        on_top = stack.achieved().copy()
        on_top[:2], on_top[2] = on_top[5:7], on_top[7] + 0.045
        success = task.judge(stack.achieved(), stack.achieved(), on_top)
        assert success == robosuite_success(stack), seed
        agreed.add(success)
    assert agreed == {True, False}


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_cube_looks_the_same_on_any_of_its_faces(turns: int) -> None:
    """c and s are (cos, sin) of four times the yaw, whichever face is up."""
    for yaw in (-0.4, 0.0, 0.7):
        c, s = np.cos(yaw), np.sin(yaw)
        flat = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        tipped = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        expected = [np.cos(4 * yaw), np.sin(4 * yaw)]
        for rest in (np.linalg.matrix_power(quarter, turns), np.linalg.matrix_power(tipped, turns)):
            np.testing.assert_allclose(yaw_code(flat @ rest, 4), expected, atol=1e-12)
    np.testing.assert_allclose(yaw_code(flat, 2), [np.cos(1.4), np.sin(1.4)], atol=1e-12)


def upside_down(stack: PiecesEnv, seed: int) -> bool:
    """The lower one cannot go first: what is on it is laid aside, though its own place is taken still."""
    a, b = stack.pieces.all
    stack.reset(seed)
    stack.stack(a, b, np.random.default_rng(seed))
    stack.refresh()
    goal = stack.achieved().copy()
    goal[[0, 1, 2]], goal[[5, 6, 7]] = (0.05, 0.1, 0.82), (0.05, 0.1, 0.865)  # B on A, elsewhere
    return reach(stack, goal)


def swapped(stack: PiecesEnv, seed: int) -> bool:
    """Each is to be where the other is."""
    a, b = stack.pieces.all
    yaws = np.random.default_rng(seed).uniform(-0.7, 0.7, 2)
    stack.reset(seed)
    stack.lay(a, np.array([0.0, -0.08]), yaws[0])
    stack.lay(b, np.array([0.05, 0.1]), yaws[1])
    stack.refresh()
    goal = stack.achieved().copy()
    goal[:2], goal[5:7] = stack.achieved()[5:7], stack.achieved()[:2]
    return reach(stack, goal)


def taken_apart(stack: PiecesEnv, seed: int) -> bool:
    """Of the two ways to take a cube, one has no room for a finger: which, depends on the side they touch at."""
    a, b = stack.pieces.all
    stack.reset(seed)
    stack.lay(a, np.array([0.0, 0.0]), 0.0)
    stack.lay(b, np.roll([0.046, 0.0], seed % 2), 0.0)
    stack.refresh()
    goal = stack.achieved().copy()
    goal[:2] = (-0.1, -0.1)
    return reach(stack, goal)


@pytest.mark.slow
@pytest.mark.parametrize("made", [upside_down, swapped, taken_apart])
def test_the_expert_makes_any_arrangement_of_any_other(
    stack: PiecesEnv, made: Callable[[PiecesEnv, int], bool]
) -> None:
    assert often(made(stack, seed) for seed in range(2, 7))


def test_what_falls_off_ends_the_episode(stack: PiecesEnv) -> None:
    stack.reset(5)
    stack.lay(stack.pieces.all[0], np.array([0.6, 0.0]), 0.0)
    for _ in range(12):
        stack.step(np.zeros(7))
    assert stack.failure() == "the cubeA fell off the table"
