"""Laws of a step: it is a function of the world's own state and action, whoever else steps in this process."""

import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest

from playlearn.errors import SimulationDiverged
from playlearn.tasks import PlayTableConfig
from playlearn.tasks.playtable.world import PlayTableWorld


@pytest.fixture(scope="module")
def world() -> PlayTableWorld:
    return PlayTableConfig().build()


def actions(seed: int, steps: int) -> np.ndarray:
    drift = np.cumsum(np.random.default_rng(seed).normal(0, 0.2, (steps, 7)), axis=0)
    return np.clip(drift, -1, 1)


def drive(world: PlayTableWorld, seed: int, steps: int = 15) -> np.ndarray:
    for action in actions(seed, steps):
        world.step(action)
    return world.sim_state()


def test_looking_at_a_world_does_not_move_it(world: PlayTableWorld) -> None:
    world.reset(0)
    start = world.sim_state()
    expected = drive(world, 1)
    world.set_state(start)
    for action in actions(1, 15):
        world.step(action)
        world.observe()
        world._refresh()
        world.clone()
    np.testing.assert_array_equal(world.sim_state(), expected)


def test_worlds_stepped_in_turn_go_as_they_would_alone(world: PlayTableWorld) -> None:
    world.reset(0)
    start = world.sim_state()
    alone = []
    for seed in (1, 2, 3):
        world.set_state(start)
        alone.append(drive(world, seed))
    world.set_state(start)
    twins = [world.clone() for _ in alone]
    for moves in zip(*(actions(seed, 15) for seed in (1, 2, 3)), strict=True):
        for twin, move in zip(twins, moves, strict=True):
            twin.step(move)
    for twin, expected in zip(twins, alone, strict=True):
        np.testing.assert_array_equal(twin.sim_state(), expected)


def test_threads_step_worlds_as_one_thread_does(world: PlayTableWorld) -> None:
    world.reset(0)
    start = world.sim_state()
    expected = {}
    for seed in (1, 2):
        world.set_state(start)
        expected[seed] = drive(world, seed)
    world.set_state(start)
    twins = {seed: world.clone() for seed in expected}
    threads = [threading.Thread(target=drive, args=(twins[seed], seed)) for seed in expected]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, twin in twins.items():
        np.testing.assert_array_equal(twin.sim_state(), expected[seed])


def test_others_simulations_are_left_alone(world: PlayTableWorld) -> None:
    """Somebody else's data of the very same model is stepped in a thread, while and between our steps."""
    world.reset(0)

    def fall(data: mujoco.MjData, steps: int) -> np.ndarray:
        data.qpos[:] = home
        for _ in range(steps):
            mujoco.mj_step(world.model, data, 25)
        return data.qpos.copy()

    home = world.data.qpos.copy()
    expected = fall(mujoco.MjData(world.model), 40)
    theirs = mujoco.MjData(world.model)
    thread = threading.Thread(target=fall, args=(theirs, 40))
    thread.start()
    while thread.is_alive():
        drive(world, 1, 5)
    thread.join()
    np.testing.assert_array_equal(theirs.qpos, expected)
    assert (theirs.ctrl == 0).all()
    assert mujoco.get_mjcb_control() is None


@pytest.mark.slow
def test_what_blows_up_is_told_and_leaves_no_log(
    world: PlayTableWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world.reset(0)
    good = world.sim_state()
    for wrong in (1e12, np.nan):
        world.data.qvel[:] = wrong
        with pytest.raises(SimulationDiverged, match=r"at 0\.00 s"):
            world.step(np.zeros(7))
        world.set_state(good)
    assert not list(tmp_path.iterdir())  # MuJoCo would write MUJOCO_LOG.TXT wherever one happens to be
    expected = drive(world, 1)
    world.set_state(good)
    np.testing.assert_array_equal(drive(world, 1), expected)


def test_the_hand_goes_where_the_action_points(world: PlayTableWorld) -> None:
    """It lags: of 8 steps of 1.5 cm asked for it has gone a fifth or more, and hardly any other way."""
    world.reset(0)
    start = world.sim_state()
    for axis in range(3):
        world.set_state(start)
        before = world.observe().state[:3].copy()
        move = np.zeros(7)
        move[axis] = 0.3
        for _ in range(8):
            world.step(move)
        went = world.observe().state[:3] - before
        assert went[axis] > 0.024
        assert np.abs(np.delete(went, axis)).max() < 0.2 * went[axis]
