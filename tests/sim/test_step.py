"""Laws of a step: it is a function of the environment's own state and action, whoever else steps in this process."""

import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest

from playlearn.envs import PlayTableConfig
from playlearn.envs.playtable.env import PlayTableEnv
from playlearn.errors import SimulationDiverged


@pytest.fixture(scope="module")
def env() -> PlayTableEnv:
    return PlayTableConfig().build()


def actions(seed: int, steps: int) -> np.ndarray:
    drift = np.cumsum(np.random.default_rng(seed).normal(0, 0.2, (steps, 7)), axis=0)
    return np.clip(drift, -1, 1)


def drive(env: PlayTableEnv, seed: int, steps: int = 15) -> np.ndarray:
    for action in actions(seed, steps):
        env.step(action)
    return env.sim_state()


def test_looking_at_a_world_does_not_move_it(env: PlayTableEnv) -> None:
    env.reset(0)
    start = env.sim_state()
    expected = drive(env, 1)
    env.set_state(start)
    for action in actions(1, 15):
        env.step(action)
        env.observe()
        env._refresh()
        env.clone()
    np.testing.assert_array_equal(env.sim_state(), expected)


def test_worlds_stepped_in_turn_go_as_they_would_alone(env: PlayTableEnv) -> None:
    env.reset(0)
    start = env.sim_state()
    alone = []
    for seed in (1, 2, 3):
        env.set_state(start)
        alone.append(drive(env, seed))
    env.set_state(start)
    twins = [env.clone() for _ in alone]
    for moves in zip(*(actions(seed, 15) for seed in (1, 2, 3)), strict=True):
        for twin, move in zip(twins, moves, strict=True):
            twin.step(move)
    for twin, expected in zip(twins, alone, strict=True):
        np.testing.assert_array_equal(twin.sim_state(), expected)


def test_threads_step_worlds_as_one_thread_does(env: PlayTableEnv) -> None:
    env.reset(0)
    start = env.sim_state()
    expected = {}
    for seed in (1, 2):
        env.set_state(start)
        expected[seed] = drive(env, seed)
    env.set_state(start)
    twins = {seed: env.clone() for seed in expected}
    threads = [threading.Thread(target=drive, args=(twins[seed], seed)) for seed in expected]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, twin in twins.items():
        np.testing.assert_array_equal(twin.sim_state(), expected[seed])


def test_others_simulations_are_left_alone(env: PlayTableEnv) -> None:
    """Somebody else's data of the very same model is stepped in a thread, while and between our steps."""
    env.reset(0)

    def fall(data: mujoco.MjData, steps: int) -> np.ndarray:
        data.qpos[:] = home
        for _ in range(steps):
            mujoco.mj_step(env.model, data, 25)
        return data.qpos.copy()

    home = env.data.qpos.copy()
    expected = fall(mujoco.MjData(env.model), 40)
    theirs = mujoco.MjData(env.model)
    thread = threading.Thread(target=fall, args=(theirs, 40))
    thread.start()
    while thread.is_alive():
        drive(env, 1, 5)
    thread.join()
    np.testing.assert_array_equal(theirs.qpos, expected)
    assert (theirs.ctrl == 0).all()
    assert mujoco.get_mjcb_control() is None


@pytest.mark.slow
def test_what_blows_up_is_told_and_leaves_no_log(
    env: PlayTableEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    env.reset(0)
    good = env.sim_state()
    for wrong in (1e12, np.nan):
        env.data.qvel[:] = wrong
        with pytest.raises(SimulationDiverged, match=r"at 0\.00 s"):
            env.step(np.zeros(7))
        env.set_state(good)
    assert not list(tmp_path.iterdir())  # MuJoCo would write MUJOCO_LOG.TXT wherever one happens to be
    expected = drive(env, 1)
    env.set_state(good)
    np.testing.assert_array_equal(drive(env, 1), expected)


def test_the_hand_goes_where_the_action_points(env: PlayTableEnv) -> None:
    """It lags: of 8 steps of 1.5 cm asked for it has gone a fifth or more, and hardly any other way."""
    env.reset(0)
    start = env.sim_state()
    for axis in range(3):
        env.set_state(start)
        before = env.observe().state[:3].copy()
        move = np.zeros(7)
        move[axis] = 0.3
        for _ in range(8):
            env.step(move)
        went = env.observe().state[:3] - before
        assert went[axis] > 0.024
        assert np.abs(np.delete(went, axis)).max() < 0.2 * went[axis]


def test_a_parked_robot_is_where_it_was_and_all_else_stays(env: PlayTableEnv) -> None:
    env.reset(0)
    start, began = env.sim_state(), env.observe()
    drive(env, 4, 40)
    moved = env.observe()
    assert np.abs(moved.state - began.state).max() > 0.05
    env.park(start)
    parked = env.observe()
    np.testing.assert_allclose(parked.state, began.state, atol=1e-6)
    np.testing.assert_array_equal(parked.achieved, moved.achieved)
