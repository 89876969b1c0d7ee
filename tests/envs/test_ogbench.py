"""OGBench's environments are its own: the same dynamics, pixels, starts, goals and play, in one process bit for bit."""

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.config import from_dict
from playlearn.envs import LiftConfig, OgbenchCubeConfig, OgbenchPlayConfig, OgbenchSceneConfig
from playlearn.episode import Goal, Observation
from playlearn.errors import UsageError
from playlearn.evaluation import load_suite
from playlearn.oracles import PlayConfig, expert_for
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.rollout import rollout
from playlearn.sim import CameraConfig, EnvironmentConfig
from playlearn.store.ogbench import OgbenchFile
from tests.shares import often

SUITES = Path(__file__).parents[2] / "eval" / "suites"

pytest.importorskip("ogbench", reason="the extra `ogbench` is not installed")


@pytest.fixture(scope="module")
def scene() -> Any:
    return OgbenchSceneConfig().build()


@pytest.fixture(scope="module")
def two() -> Any:
    return OgbenchCubeConfig(cubes=2).build()


def theirs(kind: str, **options: Any) -> Any:
    from ogbench.manipspace.envs.cube_env import CubeEnv
    from ogbench.manipspace.envs.scene_env import SceneEnv

    options |= {"mode": "data_collection", "terminate_at_goal": False, "visualize_info": False}
    return SceneEnv("scene", **options) if kind == "scene" else CubeEnv(kind, **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["double", "scene"])
def test_a_step_is_ogbenchs_own_bit_for_bit(kind: str, scene: Any, two: Any) -> None:
    """Clones, restored states and renderings in between change nothing."""
    env, other = {"double": two, "scene": scene}[kind], theirs(kind)
    env.reset(5)
    other.reset(seed=5)
    rng = np.random.default_rng(5)
    for t in range(60):
        # Down on a button, where there is one: its switch is what MuJoCo does not know.
        target = np.array([0.58, -0.05, 0.19 if t < 25 else 0.09])
        towards = np.clip((target - env.observe().state[:3]) / 0.05, -1, 1)
        action = np.array([*towards, rng.uniform(-1, 1), 1.0])
        *_, info = other.step(action)
        env.step(action)
        if t % 20 == 10:
            saved = env.sim_state()
            twin = env.clone()
            twin.step(-action)
            env.set_state(saved)
    np.testing.assert_array_equal(env.data.qpos, info["qpos"])
    np.testing.assert_array_equal(env.data.qvel, info["qvel"])
    seen = env.observe()
    np.testing.assert_allclose(seen.state[:3], info["proprio/effector_pos"], atol=1e-7)  # float32
    np.testing.assert_allclose(np.arctan2(seen.state[4], seen.state[3]), info["proprio/effector_yaw"][0], atol=1e-6)
    np.testing.assert_allclose(1 - seen.state[5] / 0.085, info["proprio/gripper_opening"][0], atol=1e-6)
    np.testing.assert_allclose(seen.state[6], info["proprio/gripper_contact"][0], atol=1e-6)
    np.testing.assert_allclose(seen.achieved[:3], info["privileged/block_0_pos"], atol=1e-6)
    if kind == "scene":
        np.testing.assert_array_equal(seen.achieved[[8, 12]], info["button_states"])
        np.testing.assert_allclose(seen.achieved[13:16], info["privileged/drawer_handle_pos"], atol=1e-6)
        np.testing.assert_allclose(seen.achieved[16:19], info["privileged/window_handle_pos"], atol=1e-6)


@pytest.mark.slow
def test_exact_images_are_ogbenchs_and_quick_ones_are_near(scene: Any) -> None:
    from mujoco import Renderer

    exact = OgbenchSceneConfig(exact=True).build()
    for env in (exact, scene):
        env.reset(3)
    other = theirs("scene")
    other._ob_type = "pixels"  # the scene of the pixel environments, drawn by us
    other._mjcf_model = other.build_mjcf_model()
    other._ob_type = "states"
    other.reset(seed=3)
    renderer = Renderer(other.model, 64, 64)
    renderer.update_scene(other.data, camera="front_pixels")
    expected = renderer.render()
    renderer.close()
    picture = exact.render("front")
    np.testing.assert_array_equal(picture, expected)
    state = exact.sim_state()
    exact.reset(4)
    exact.set_state(state)
    np.testing.assert_array_equal(exact.render("front"), picture)
    off = np.abs(scene.render("front").astype(int) - picture)
    assert off.mean() < 6  # of 255; measured 4.4: four samples where theirs are others, shadows no finer than the image


def test_the_protocol_is_theirs(scene: Any, two: Any) -> None:
    """The tables' numbers: five tasks of 50 episodes, 200, 500 and 750 steps, success as soon as it is there."""
    import ogbench.manipspace  # noqa: F401 - registers
    from gymnasium.envs.registration import registry

    names = {"cube_single": "cube-single-v0", "cube_double": "cube-double-v0", "scene": "scene-v0"}
    for name, theirs in names.items():
        suite = load_suite(SUITES / f"ogbench_{name}.yaml")
        assert suite.max_steps == registry[theirs].max_episode_steps
        assert (suite.episodes, suite.success_hold_steps) == (250, 1)
    for env in (scene, two):
        assert list(env.tasks) == [info["task_name"] for info in env.env.task_infos]
        assert len(env.tasks) == 5


def test_tasks_are_posed_as_ogbench_poses_them(two: Any) -> None:
    """Starts within 1 cm of the nominal places, goals where they have settled; both in an order drawn for both."""
    kind = load_suite(SUITES / "ogbench_cube_double.yaml").kind
    orders = set()
    for episode in range(8):
        setup = kind.setup(two, None, episode, 0, 500, ())
        again = kind.setup(two, None, episode, 0, 500, ())
        np.testing.assert_array_equal(setup.start_sim_state, again.start_sim_state)
        np.testing.assert_array_equal(setup.goal_sim_state, again.goal_sim_state)
        info = two.env.task_infos[episode % 5]
        start, goal = setup.start_achieved.reshape(-1, 5), setup.goal.achieved.reshape(-1, 5)
        order = [int(np.abs(info["init_xyzs"] - row[:3]).sum(axis=1).argmin()) for row in start]
        orders.add(tuple(order))
        assert np.abs(start[:, :3] - info["init_xyzs"][order]).max() <= 0.01 + 1e-6
        assert np.abs(goal[:, :3] - info["goal_xyzs"][order]).max() < 2e-3
        task = two.tasks[setup.task]
        assert task.judge(start.ravel(), goal.ravel(), goal.ravel())
        assert not task.judge(start.ravel(), start.ravel(), goal.ravel())
        assert setup.goal.state is not None  # the arm, for goals that show everything
        assert np.abs(setup.goal.state[:3] - two.observe().state[:3]).max() < 1e-6
    assert len(orders) == 2


def test_success_is_theirs(scene: Any) -> None:
    """Within 4 cm in space, of joints for drawer and window, and every button as shown."""
    task = scene.tasks["task3_rearrange_medium"]
    goal = task.command(scene.observe().achieved, np.random.default_rng(0))
    for column, by in ((0, 0.039), (2, 0.039), (14, 0.039), (16, -0.039)):
        near, far = goal.copy(), goal.copy()
        near[column] += by
        far[column] += by * 0.041 / 0.039
        assert task.judge(goal, near, goal)
        assert not task.judge(goal, far, goal)
    for column in (8, 12):
        other = goal.copy()
        other[column] = 1 - other[column]
        assert not task.judge(goal, other, goal)
    both = goal.copy()
    both[[0, 1]] += 0.03  # 4.2 cm
    assert not task.judge(goal, both, goal)


def reached(env: Any, name: str, seed: int) -> bool:
    """Whether the expert does that task from a start of its own, in OGBench's time."""
    task, steps = env.tasks[name], {"task4_swap": 500, "task5_rearrange_hard": 750}[name]
    goal_state = task.pose(env, np.random.default_rng(seed))
    start = env.sim_state()
    env.set_state(goal_state)
    goal = env.observe().achieved
    env.set_state(start)

    def there(_: int, seen: Observation) -> bool:
        return task.judge(goal, seen.achieved, goal)

    return rollout([env], expert_for(env), [Goal(goal)], seeds=[0], max_steps=steps, stop=there)[0].ended == "stopped"


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name"), [("double", "task4_swap"), ("scene", "task5_rearrange_hard")])
def test_the_expert_does_the_hardest_tasks(kind: str, name: str, scene: Any, two: Any) -> None:
    """A swap needs a cube laid aside; the hardest of the scene eight changes in their order."""
    env = {"double": two, "scene": scene}[kind]
    assert often((reached(env, name, seed) for seed in range(1, 5)), done=1)


def settled(scene: Any, seed: int) -> bool:
    """Whether 15 s of play hold two settled targets, of more than one object; a target takes 1.5 to 5 s."""
    scene.reset(seed)
    episode = rollout([scene], OgbenchPlayConfig().build(scene), [None], seeds=[seed], max_steps=300)[0].episode
    assert episode is not None
    meta = episode.meta
    table = RelabelIndex.build(
        [episode.achieved], meta.achieved_names, meta.fps, SettlingConfig(), meta.quantities.achieved
    )
    objects = {group for group, count in table.change_counts().items() if count}
    return len(episode.meta.skills) >= 2 and table.offsets[-1] >= 2 and len(objects) >= 2


@pytest.mark.slow
def test_play_settles_on_many_objects(scene: Any) -> None:
    """And its skills say which."""
    assert often((settled(scene, seed) for seed in range(2, 10)), done=1, missed=8)


def test_what_does_not_fit_is_said(scene: Any) -> None:
    with pytest.raises(UsageError, match="cubes: between 1 and 4"):
        from_dict(EnvironmentConfig, {"type": "ogbench_cube", "cubes": 9})
    with pytest.raises(UsageError, match="no camera 'wrist'"):
        OgbenchCubeConfig(cameras={"wrist": CameraConfig()})
    with pytest.raises(UsageError, match="noise"):
        OgbenchPlayConfig(noise=-1.0)
    with pytest.raises(UsageError, match="'ogbench_scene' has no skill library"):
        PlayConfig().build(scene)
    with pytest.raises(UsageError, match="OGBench's environments only"):
        OgbenchPlayConfig().build(LiftConfig().build())
    play_policy = OgbenchPlayConfig().build(scene)
    with pytest.raises(UsageError, match="one environment at a time"):
        play_policy.reset([None, None], [0, 1])


def test_without_the_extra_the_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ogbench", None)
    for build in (OgbenchCubeConfig().build, OgbenchSceneConfig().build, lambda: OgbenchPlayConfig().build(None)):
        with pytest.raises(UsageError, match=r"pip install 'playlearn\[ogbench\]'"):
            build()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["single", "scene"])
def test_an_imported_dataset_holds_what_our_environment_would(kind: str, scene: Any, tmp_path: Path) -> None:
    """OGBench's own observations of its own play, through its own file, are our numbers; its states are drawn here."""
    env = scene if kind == "scene" else OgbenchCubeConfig().build()
    env.reset(9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = theirs(kind)
        observation, info = other.reset(seed=9)
    rows: dict[str, list[Any]] = {"observations": [], "actions": [], "qpos": [], "qvel": [], "button_states": []}
    states, achieved = [], []
    rng = np.random.default_rng(9)
    for _ in range(6):
        action = rng.uniform(-1, 1, 5)
        rows["observations"].append(observation)
        rows["actions"].append(action)
        rows["qpos"].append(info["qpos"])
        rows["qvel"].append(info["qvel"])
        rows["button_states"].append(info.get("button_states", ()))
        states.append(env.observe().state)
        achieved.append(env.observe().achieved)
        observation, *_, info = other.step(action)
        env.step(action)
    arrays = {name: np.array(values, np.float32) for name, values in rows.items() if len(values[0])}
    np.savez(tmp_path / "a.npz", terminals=np.arange(6) == 5, **arrays)
    found = OgbenchFile(tmp_path / "a.npz")
    assert from_dict(EnvironmentConfig, found.spec.environment) == type(env.config)()
    assert found.spec.state_names == env.spec.state_names
    assert found.spec.achieved_names == env.spec.achieved_names
    assert found.spec.action_names == env.spec.action_names
    assert found.spec.fps == env.spec.fps
    [(_, episode)] = list(found.read([0]))
    np.testing.assert_allclose(episode.state, states[:6], atol=2e-5)  # float32, times 10 and back
    np.testing.assert_allclose(episode.achieved, achieved[:6], atol=2e-5)
    env.set_state(episode.sim_state[3])
    np.testing.assert_allclose(env.observe().achieved, achieved[3], atol=2e-5)
    assert env.render("front").std() > 10
