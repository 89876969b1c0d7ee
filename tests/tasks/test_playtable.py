"""Laws of the PlayTable world: what is saved is restored, what is refused leaves no trace, starts are sound."""

import numpy as np
import pytest

from playlearn.errors import ActionError, SimulationDiverged, UsageError
from playlearn.sim import CameraConfig
from playlearn.tasks import PlayTableConfig
from playlearn.tasks.playtable import scene
from playlearn.tasks.playtable.named import BLOCK_NAMES, DRAWER, LAMP, block, in_tray, on_table, supporter
from playlearn.tasks.playtable.world import PlayTableWorld


@pytest.fixture(scope="module")
def world() -> PlayTableWorld:
    return PlayTableConfig().build()


def wander(world: PlayTableWorld, seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        world.step(np.append(rng.uniform(-0.5, 0.5, 6), rng.choice([-1, 1])))


def test_a_saved_state_goes_on_exactly_as_the_world_did(world: PlayTableWorld) -> None:
    world.reset(0)
    wander(world, 1, 10)
    saved = world.sim_state()
    wander(world, 2, 25)
    expected = world.sim_state(), world.observe().state
    wander(world, 3, 5)
    world.set_state(saved)
    np.testing.assert_array_equal(world.sim_state(), saved)
    wander(world, 2, 25)
    np.testing.assert_array_equal(world.sim_state(), expected[0])  # bit for bit: nothing hides outside the state
    np.testing.assert_array_equal(world.observe().state, expected[1])


def test_a_clone_goes_its_own_way(world: PlayTableWorld) -> None:
    world.reset(4)
    before = world.sim_state()
    twin = world.clone()
    wander(twin, 5, 10)
    np.testing.assert_array_equal(world.sim_state(), before)
    wander(world, 5, 10)
    np.testing.assert_array_equal(world.sim_state(), twin.sim_state())


def test_the_same_seed_gives_the_same_start(world: PlayTableWorld) -> None:
    world.reset(7)
    first = world.sim_state()
    world.reset(8)
    assert not np.array_equal(first, world.sim_state())
    world.reset(7)
    np.testing.assert_array_equal(first, world.sim_state())


def test_starts_are_at_rest_and_free_of_collisions(world: PlayTableWorld) -> None:
    for seed in range(40):
        world.reset(seed)
        start = world.achieved()
        assert world.failure() is None
        for i in range(len(BLOCK_NAMES)):
            lies = on_table(start, i) or in_tray(start, i) or supporter(start, i) is not None
            assert lies, f"seed {seed}: {BLOCK_NAMES[i]} at {block(start, i)}"
        for _ in range(10):
            world.step(np.array([0, 0, 0, 0, 0, 0, -1.0]))
        # Blocks that overlapped would have been thrown apart by more than the 2 mm of settling.
        np.testing.assert_allclose(world.achieved()[:16], start[:16], atol=0.002)


@pytest.mark.parametrize(
    ("action", "says"),
    [
        (np.full(7, np.nan), "not finite"),
        (np.zeros(6), "shape"),
        (np.full(7, 1.5), r"\[-1, 1\]"),
    ],
)
def test_a_bad_action_is_refused_and_leaves_the_world_alone(
    world: PlayTableWorld, action: np.ndarray, says: str
) -> None:
    world.reset(0)
    before = world.sim_state()
    with pytest.raises(ActionError, match=says):
        world.step(action)
    np.testing.assert_array_equal(world.sim_state(), before)


def test_a_diverged_simulation_is_told_and_can_be_left(world: PlayTableWorld) -> None:
    world.reset(0)
    good = world.sim_state()
    world.data.qvel[:] = 1e12
    with pytest.raises(SimulationDiverged, match=r"diverged|gave up"):
        world.step(np.zeros(7))
    world.set_state(good)
    world.step(np.zeros(7))
    assert np.isfinite(world.observe().state).all()


def test_a_block_that_falls_off_ends_the_episode(world: PlayTableWorld) -> None:
    world.reset(0)
    world.put(0, [0.5, 0.0, scene.TABLE_Z + 0.05], 0.0)  # beyond the far edge
    for _ in range(12):
        world.step(np.zeros(7))
    assert world.failure() == "the red block fell off the table"


def test_fixtures_have_limits_and_springs(world: PlayTableWorld) -> None:
    world.reset(1)
    world.slide_drawer(0.05)
    world.refresh()
    drawer, button = world.model.joint("drawer_slide").dofadr[0], world.model.joint("button_press").qposadr[0]
    world.data.qvel[drawer] = 3.0  # a hard pull
    for _ in range(30):
        world.step(np.zeros(7))
    assert world.achieved()[DRAWER] <= scene.DRAWER_TRAVEL + 0.002  # its stop holds
    assert abs(world.data.qvel[drawer]) < 1e-2  # friction brings it to rest
    world.data.qpos[button] = scene.BUTTON_TRAVEL
    lamp = world.achieved()[LAMP]
    world.step(np.zeros(7))
    for _ in range(20):
        world.step(np.zeros(7))
    assert world.data.qpos[button] < 0.001  # the spring brings it back
    assert lamp in (0.0, 1.0)


def test_the_button_toggles_once_a_press(world: PlayTableWorld) -> None:
    world.reset(2)
    button = world.model.joint("button_press").qposadr[0]
    lamp = world.achieved()[LAMP]
    seen = []
    for depth in (0.0, 0.012, 0.012, 0.012, 0.0, 0.012):
        world.data.qpos[button] = depth
        world._after_step()
        seen.append(float(world.achieved()[LAMP]))
    assert seen == [lamp, 1 - lamp, 1 - lamp, 1 - lamp, 1 - lamp, lamp]


def test_orientation_is_the_same_for_a_block_turned_half_round(world: PlayTableWorld) -> None:
    world.reset(3)
    for yaw in (-1.0, 0.0, 0.7):
        seen = []
        for turned in (yaw, yaw + np.pi):
            world.put(0, [0.0, 0.0, scene.TABLE_Z + 0.0201], turned)
            world._refresh()
            seen.append(block(world.achieved(), 0)[3:].copy())
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
        np.testing.assert_allclose(seen[0], [np.cos(2 * yaw), np.sin(2 * yaw)], atol=1e-6)


def test_reached_is_true_of_itself_and_false_of_each_change(world: PlayTableWorld) -> None:
    world.reset(5)
    goal = world.achieved()
    assert world.reached(goal, goal)
    for index, shift in {0: 0.05, 2: 0.03, DRAWER: 0.04, LAMP: 1.0}.items():
        other = goal.copy()
        other[index] += shift if index != LAMP else 1 - 2 * goal[LAMP]
        assert not world.reached(other, goal), world.spec.achieved_names[index]


def test_every_task_can_be_set_up_and_is_not_won_at_the_start(world: PlayTableWorld) -> None:
    for name, task in world.tasks.items():
        for draw in range(100):
            rng = np.random.default_rng([draw, 1])
            world.reset(draw)
            task.arrange(world, rng)
            start = world.achieved()
            goal = task.command(start, rng)
            if task.precondition(start) and not np.array_equal(goal, start):
                break
        else:
            pytest.fail(f"{name}: no start in 100 draws")
        assert not task.judge(start, start, goal), name
        assert task.judge(start, goal, goal), name


def test_other_robots_play_at_the_same_table() -> None:
    other = PlayTableConfig(robot="UR5e").build()
    other.reset(0)
    before = other.observe().state
    for _ in range(10):
        other.step(np.array([0.0, 0.0, -0.5, 0, 0, 0, -1]))
    moved = other.observe().state - before
    assert moved[2] < -0.02  # it went down, and did not drift sideways by more than a third of that
    assert np.abs(moved[:2]).max() < 0.33 * abs(moved[2])


def test_an_unknown_robot_or_camera_is_named() -> None:
    with pytest.raises(UsageError, match=r"Pander.*Panda"):
        PlayTableConfig(robot="Pander").build()
    with pytest.raises(UsageError, match=r"Baxter.*one arm"):
        PlayTableConfig(robot="Baxter").build()
    with pytest.raises(UsageError, match=r"side.*front"):
        PlayTableConfig(cameras={"side": CameraConfig()}).build()
