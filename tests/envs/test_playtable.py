"""Laws of the PlayTable environment: what is saved is restored, what is refused leaves no trace, starts are sound."""

import numpy as np
import pytest

from playlearn.envs import PlayTableConfig
from playlearn.envs.playtable import scene
from playlearn.envs.playtable.env import PlayTableEnv
from playlearn.envs.playtable.layout import (
    ACHIEVED_NAMES,
    BLOCK_NAMES,
    BULB,
    DRAWER,
    LED,
    LEVER,
    SLIDER,
    block,
    direction,
    in_bay,
    in_tray,
    on_table,
    supporter,
)
from playlearn.errors import ActionError, SimulationDiverged, UsageError
from playlearn.sim import CameraConfig


@pytest.fixture(scope="module")
def env() -> PlayTableEnv:
    return PlayTableConfig().build()


def wander(env: PlayTableEnv, seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        env.step(np.append(rng.uniform(-0.5, 0.5, 6), rng.choice([-1, 1])))


def test_a_saved_state_goes_on_exactly_as_the_world_did(env: PlayTableEnv) -> None:
    env.reset(0)
    wander(env, 1, 10)
    saved = env.sim_state()
    wander(env, 2, 25)
    expected = env.sim_state(), env.observe().state
    wander(env, 3, 5)
    env.set_state(saved)
    np.testing.assert_array_equal(env.sim_state(), saved)
    wander(env, 2, 25)
    np.testing.assert_array_equal(env.sim_state(), expected[0])  # bit for bit: nothing hides outside the state
    np.testing.assert_array_equal(env.observe().state, expected[1])


def test_a_clone_goes_its_own_way(env: PlayTableEnv) -> None:
    env.reset(4)
    before = env.sim_state()
    twin = env.clone()
    wander(twin, 5, 10)
    np.testing.assert_array_equal(env.sim_state(), before)
    wander(env, 5, 10)
    np.testing.assert_array_equal(env.sim_state(), twin.sim_state())


def test_the_same_seed_gives_the_same_start(env: PlayTableEnv) -> None:
    env.reset(7)
    first = env.sim_state()
    env.reset(8)
    assert not np.array_equal(first, env.sim_state())
    env.reset(7)
    np.testing.assert_array_equal(first, env.sim_state())


@pytest.mark.slow
def test_starts_are_at_rest_and_free_of_collisions(env: PlayTableEnv) -> None:
    for seed in range(40):
        env.reset(seed)
        start = env.achieved()
        assert env.failure() is None
        for i in range(len(BLOCK_NAMES)):
            lies = on_table(start, i) or in_tray(start, i) or in_bay(start, i) or supporter(start, i) is not None
            assert lies, f"seed {seed}: {BLOCK_NAMES[i]} at {block(start, i)}"
        for _ in range(10):
            env.step(np.array([0, 0, 0, 0, 0, 0, -1.0]))
        # Blocks that overlapped would have been thrown apart by more than the 2 mm of settling.
        np.testing.assert_allclose(env.achieved(), start, atol=0.002)


@pytest.mark.slow
def test_starts_show_all_that_the_table_has(env: PlayTableEnv) -> None:
    """Of 120 starts, each fraction that the config names comes true within four standard errors."""
    starts = []
    for seed in range(120):
        env.reset(seed)
        starts.append(env.achieved())
    for of, fraction in {
        in_tray: env.config.stowed,
        in_bay: env.config.shelved,
        lambda a, i: supporter(a, i) is not None: env.config.stacked * (1 - 0.2 * 0.25),  # no block is left for it
    }.items():
        seen = np.mean([any(of(start, i) for i in range(3)) for start in starts])
        assert abs(seen - fraction) < 4 * np.sqrt(fraction * (1 - fraction) / 120)
    for index in (DRAWER, SLIDER, LEVER, LED, BULB):
        assert np.ptp([start[index] for start in starts]) > 0.15, ACHIEVED_NAMES[index]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.full(7, np.nan), "not finite"),
        (np.zeros(6), "shape"),
        (np.full(7, 1.5), r"\[-1, 1\]"),
    ],
)
def test_a_bad_action_is_refused_and_leaves_the_state_alone(
    env: PlayTableEnv, action: np.ndarray, message: str
) -> None:
    env.reset(0)
    before = env.sim_state()
    with pytest.raises(ActionError, match=message):
        env.step(action)
    np.testing.assert_array_equal(env.sim_state(), before)


def test_a_diverged_simulation_is_told_and_can_be_left(env: PlayTableEnv) -> None:
    env.reset(0)
    good = env.sim_state()
    env.data.qvel[:] = 1e12
    with pytest.raises(SimulationDiverged, match=r"diverged|gave up"):
        env.step(np.zeros(7))
    env.set_state(good)
    env.step(np.zeros(7))
    assert np.isfinite(env.observe().state).all()


def test_a_block_that_falls_off_ends_the_episode(env: PlayTableEnv) -> None:
    env.reset(0)
    env.put(0, [0.5, 0.0, scene.TABLE_Z + 0.05], 0.0)  # beyond the far edge
    for _ in range(12):
        env.step(np.zeros(7))
    assert env.failure() == "the red block fell off the table"


@pytest.mark.parametrize(
    ("name", "index", "travel"),
    [("drawer_slide", DRAWER, scene.DRAWER_TRAVEL), ("slider_slide", SLIDER, scene.SLIDER_TRAVEL)],
)
def test_what_slides_has_stops_and_friction(env: PlayTableEnv, name: str, index: int, travel: float) -> None:
    joint = env.model.joint(name)
    for pull, end in ((3.0, travel), (-3.0, 0.0)):
        env.reset(1)
        env.data.qpos[joint.qposadr[0]] = travel / 2
        env.data.qvel[joint.dofadr[0]] = pull  # a hard one
        for _ in range(30):
            env.step(np.zeros(7))
        assert abs(env.achieved()[index] - travel / 2) > 0.02  # it went the way it was pulled,
        assert np.sign(env.achieved()[index] - travel / 2) == np.sign(pull)
        assert (env.achieved()[index] - end) * np.sign(pull) <= 0.002  # its stop holds,
        assert abs(env.data.qvel[joint.dofadr[0]]) < 1e-2  # and friction brings it to rest


def test_the_slider_runs_over_a_lying_block_and_the_drawer_takes_one_along(env: PlayTableEnv) -> None:
    env.reset(1)
    for i in range(3):
        env.lay(i, (0.1, -0.15 + 0.1 * i), 0.0)
    env.slide_drawer(scene.DRAWER_TRAVEL)
    env.slide_slider(0.0)
    env.stow(0, np.random.default_rng(0))
    env.lay(1, scene.BAY_CENTER, np.pi / 2)
    env.refresh()
    before = env.achieved()
    slider, drawer = (env.model.joint(name).dofadr[0] for name in ("slider_slide", "drawer_slide"))
    for _ in range(20):  # a second under 4 N against 1.5 N of friction and 8 N s/m: some 0.3 m
        env.data.qfrc_applied[[slider, drawer]] = 4.0, -4.0
        env.step(np.zeros(7))
    env.data.qfrc_applied[:] = 0.0
    after = env.achieved()
    assert after[SLIDER] > 0.15
    assert after[DRAWER] < 0.02
    np.testing.assert_allclose(block(after, 1), block(before, 1), atol=1e-3)
    moved = after[DRAWER] - before[DRAWER]
    np.testing.assert_allclose(block(after, 0)[:3], block(before, 0)[:3] + np.array([0, moved, 0]), atol=0.01)


def test_the_lever_falls_to_either_side_and_stays_there_and_the_bulb_tells(env: PlayTableEnv) -> None:
    env.reset(2)
    lever = env.model.joint("lever_hinge").qposadr[0]
    for angle in (-0.1, 0.1):
        env.data.qpos[lever] = angle
        for _ in range(20):
            env.step(np.zeros(7))
        # The stop gives way by less than a hundredth of a radian under the weight of the knob.
        assert abs(env.achieved()[LEVER] - np.sign(angle) * scene.LEVER_RANGE) < 0.01
        assert env.achieved()[BULB] == float(angle > 0)


def test_the_button_springs_back(env: PlayTableEnv) -> None:
    env.reset(1)
    button = env.model.joint("button_press").qposadr[0]
    env.data.qpos[button] = scene.BUTTON_TRAVEL
    for _ in range(20):
        env.step(np.zeros(7))
    assert env.data.qpos[button] < 0.001


def test_the_button_toggles_once_a_press(env: PlayTableEnv) -> None:
    env.reset(2)
    button = env.model.joint("button_press").qposadr[0]
    led = env.achieved()[LED]
    seen = []
    for depth in (0.0, 0.012, 0.012, 0.012, 0.0, 0.012):
        env.data.qpos[button] = depth
        env._after_step()
        seen.append(float(env.achieved()[LED]))
    assert seen == [led, 1 - led, 1 - led, 1 - led, 1 - led, led]


@pytest.mark.slow
@pytest.mark.parametrize("lamp", ["lamp", "lever"])
def test_each_lamp_is_seen_to_be_lit(env: PlayTableEnv, lamp: str) -> None:
    env.reset(0)
    pictures = []
    for lit in (False, True):
        env.switch(**{lamp: lit})
        pictures.append(env.render("front").astype(int))
    changed = np.abs(pictures[1] - pictures[0]).max(axis=2) > 60
    assert 8 < changed.sum() < 0.05 * changed.size  # a lamp of some pixels (and the lever), and nothing else


def test_fixtures_never_touch_each_other(env: PlayTableEnv) -> None:
    model = env.model
    fixtures = [
        g for g in range(model.ngeom) if model.geom_contype[g] and not model.geom_conaffinity[g]
    ]  # what asks for nobody's touch is touched by those who ask: the robot and the blocks
    names = {model.geom(g).name for g in fixtures}
    assert {"deck_top", "tray_front", "tray_post", "slider_roof", "slider_post", "lever_knob", "button_cap"} <= names
    env.reset(3)
    env.slide_drawer(0.0)
    env.refresh()
    touching = [{int(c.geom1), int(c.geom2)} for c in env.data.contact[: env.data.ncon]]
    assert not any(pair <= set(fixtures) for pair in touching)


def test_orientation_is_the_same_for_a_block_turned_half_round(env: PlayTableEnv) -> None:
    env.reset(3)
    for yaw in (-1.0, 0.0, 0.7):
        seen = []
        for turned in (yaw, yaw + np.pi):
            env.put(0, [0.0, 0.0, scene.TABLE_Z + 0.0201], turned)
            env._refresh()
            seen.append(block(env.achieved(), 0)[3:].copy())
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
        np.testing.assert_allclose(seen[0], [np.cos(2 * yaw), np.sin(2 * yaw)], atol=1e-6)


def test_reached_is_true_of_itself_and_false_of_each_change(env: PlayTableEnv) -> None:
    env.reset(5)
    goal = env.achieved()
    assert env.reached(goal, goal)
    flipped = {index: 1 - 2 * goal[index] for index in (LED, BULB)}
    for index, shift in {0: 0.05, 2: 0.03, DRAWER: 0.04, SLIDER: 0.04, **flipped}.items():
        other = goal.copy()
        other[index] += shift
        assert not env.reached(other, goal), env.spec.achieved_names[index]


def test_the_named_tasks_are_calvins(env: PlayTableEnv) -> None:
    """34 of them: 3 blocks turned and pushed to 2 sides each and lifted from 3 places, 13 others."""
    blocks = {
        f"{verb}_{name}_{where}"
        for name in BLOCK_NAMES
        for verb, places in (("rotate", "right left"), ("push", "right left"), ("lift", "table slider drawer"))
        for where in places.split()
    }
    others = """move_slider_left move_slider_right open_drawer close_drawer place_in_slider place_in_drawer
        push_into_drawer stack_block unstack_block turn_on_lightbulb turn_off_lightbulb turn_on_led turn_off_led"""
    assert set(env.tasks) == blocks | set(others.split())
    assert len(env.tasks) == 34


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


@pytest.mark.slow
def test_every_task_can_be_set_up_and_is_not_won_at_the_start(env: PlayTableEnv) -> None:
    for name, task in env.tasks.items():
        start, goal = begin(env, name, 1)
        assert not task.judge(start, start, goal), name
        assert task.judge(start, goal, goal), name


def test_right_and_left_are_the_robots_own(env: PlayTableEnv) -> None:
    """y > 0 is the robot's left; a left turn is counter-clockwise from above."""
    for name in BLOCK_NAMES:
        for side, sign in (("left", 1), ("right", -1)):
            index = BLOCK_NAMES.index(name)
            start, goal = begin(env, f"push_{name}_{side}", 2)
            assert sign * (block(goal, index)[1] - block(start, index)[1]) > 0.04
            start, goal = begin(env, f"rotate_{name}_{side}", 2)
            turned = direction(block(goal, index)) - direction(block(start, index))
            assert 0.6 < sign * turned < 1.3
            mirrored = goal.copy()  # the same turn the other way is no success
            yaw = direction(block(start, index)) - turned
            block(mirrored, index)[3:] = np.cos(2 * yaw), np.sin(2 * yaw)
            assert not env.tasks[f"rotate_{name}_{side}"].judge(start, mirrored, goal)
    for side, sign in (("left", 1), ("right", -1)):
        start, goal = begin(env, f"move_slider_{side}", 2)
        assert sign * (goal[SLIDER] - start[SLIDER]) > 0.08


def test_a_judge_asks_for_the_block_that_the_goal_shows(env: PlayTableEnv) -> None:
    """Where a task does not name its block, the goal does: the same done with another block is no success."""
    for name in ("place_in_drawer", "push_into_drawer", "place_in_slider", "stack_block", "unstack_block"):
        start, goal = begin(env, name, 3)
        moved = next(i for i in range(3) if not np.allclose(block(start, i), block(goal, i)))
        for other in set(range(3)) - {moved}:
            swapped = start.copy()
            block(swapped, other)[:] = block(goal, moved)
            assert not env.tasks[name].judge(start, swapped, goal), name


@pytest.mark.slow
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
