"""Our policies and environments in LeRobot: its loop gives the same results as ours."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from playlearn.config import from_dict
from playlearn.errors import UsageError
from playlearn.evaluation.suite import SuiteConfig, load_suite
from playlearn.evaluation.suites.tasks import TasksConfig
from playlearn.lerobot.publish import export_policy
from playlearn.policies import Policy, PolicyConfig, PolicySpec
from playlearn.policies.execution import PolicyActor
from playlearn.rollout import rollout
from tests.fakes import PointConfig, point_expert
from tests.lerobot_dataset import vector, write_dataset
from tests.policies.parts import small

if TYPE_CHECKING:
    from playlearn.evaluation.goal_env import GoalEnv

pytestmark = pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix
SUITE = SuiteConfig(
    name="point", environment=PointConfig(), kind=TasksConfig(rest_seconds=0.2), max_steps=40, success_hold_steps=2
)
SUITES = Path(__file__).parents[2] / "eval" / "suites"
SIZES = {"front": (24, 32), "wrist": (16, 16)}


@pytest.fixture
def their_env() -> "GoalEnv":
    return new_env()


def new_env() -> "GoalEnv":
    # LeRobot takes seconds to import: where it is asked for, not when tests are collected
    from playlearn.evaluation.goal_env import GoalEnv

    return GoalEnv(SUITE, expert=point_expert)


STATE, PROPRIO, IMAGE = "observation.goal.state", "observation.goal.proprio", "observation.images.goal_front"
# Every kind of goal that trains: its encoder, and what is read of the goal.
GOALS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "state": (small("state"), {STATE}),
    "pose": (small("state", goal_proprio=True, goal_names=[]), {PROPRIO}),
    "state and pose": (small("state", goal_proprio=True), {STATE, PROPRIO}),
    "image": (small("cnn"), {IMAGE}),
    "image or state": (small("cnn", goal="both"), {IMAGE, STATE}),
    "state beside images": (small("cnn", goal="state"), {STATE}),
}


@pytest.fixture(scope="module", params=GOALS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def run(kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained policy for the point environment; deterministic like a trained one."""
    env = PointConfig().build()
    names = {name: getattr(env.spec, name) for name in ("state_names", "achieved_names", "action_names", "fps")}
    parts = {"encoder": GOALS[kind][0], "trunk": small("mlp"), "head": small("deterministic"), "chunk": 4}
    policy = from_dict(PolicyConfig, parts).build(PolicySpec(**names, cameras=SIZES), None, seed=0)
    folder = tmp_path_factory.mktemp("run")
    policy.save(folder / "policy")
    return folder


def test_gymnasium_finds_nothing_to_blame(their_env: "GoalEnv") -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(their_env, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["playtable_tasks", "lift", "ogbench_scene"])
def test_gymnasium_finds_nothing_to_blame_in_our_worlds(name: str) -> None:
    """It wants a reset and a step that depend on the seed alone, and every observation within its space."""
    from gymnasium.utils.env_checker import check_env

    from playlearn.evaluation.goal_env import GoalEnv

    if name.startswith("ogbench"):
        pytest.importorskip("ogbench", reason="the extra `ogbench` is not installed")
    their_env = GoalEnv(load_suite(SUITES / f"{name}.yaml"))
    check_env(their_env, skip_render_check=True)
    their_env.close()


def test_a_seed_is_the_number_of_an_episode_of_the_suite(their_env: "GoalEnv") -> None:
    first, info = their_env.reset(seed=3)
    again, _ = new_env().reset(seed=3)
    np.testing.assert_array_equal(first["environment_state"], again["environment_state"])
    assert info["task"] == list(their_env.env.tasks)[3 % 2] == their_env.task.replace(" ", "_")
    following, _ = their_env.reset()  # without a seed: the next
    np.testing.assert_array_equal(following["goal.state"], new_env().reset(seed=4)[0]["goal.state"])
    np.testing.assert_array_equal(following["environment_state"][3:], following["goal.state"])
    assert set(following["pixels"]) == {"front", "wrist", "goal_front", "goal_wrist"}


def test_success_is_the_suites(their_env: "GoalEnv") -> None:
    their_env.reset(seed=0)
    expert = point_expert(their_env.env)
    episode = their_env._eval_episode
    assert episode is not None
    expert.reset([episode.goal], [0])
    ends = []
    while not ends or not (ends[-1][1] or ends[-1][2]):
        action = expert.act([their_env.env.observe()], [True])[0].action
        _, reward, terminated, truncated, info = their_env.step(action)
        ends.append((reward, terminated, truncated, info["is_success"]))
    assert ends[-1] == (1.0, True, False, True)
    assert all(end == (0.0, False, False, False) for end in ends[:-1])
    their_env.reset(seed=0)
    ends = [their_env.step(np.zeros(3, np.float32))[1:4] for _ in range(40)]
    assert ends == [(0.0, False, False)] * 39 + [(0.0, False, True)]  # the suite's budget
    assert their_env.render().shape[0] == 24


@pytest.mark.slow
def test_lerobots_loop_gives_our_results(run: Path, their_env: "GoalEnv", tmp_path: Path) -> None:
    import gymnasium as gym
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.processor import PolicyProcessorPipeline
    from lerobot.scripts.lerobot_eval import rollout as lerobots

    from playlearn.lerobot.modeling_playlearn import PlaylearnPolicy

    export_policy(run, tmp_path / "out")
    assert {"config.json", "model.safetensors", "README.md", "policy_preprocessor.json"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
    assert "library_name: lerobot" in (tmp_path / "out" / "README.md").read_text()
    config = PreTrainedConfig.from_pretrained(tmp_path / "out")
    assert get_policy_class(config.type) is PlaylearnPolicy
    its = PlaylearnPolicy.from_pretrained(tmp_path / "out", config=config, strict=True)
    before, after = make_pre_post_processors(config, pretrained_path=str(tmp_path / "out"))
    envs = gym.vector.SyncVectorEnv([new_env] * 2)
    nothing = PolicyProcessorPipeline(steps=[])
    done = lerobots(envs, its, nothing, nothing, before, after, seeds=[0, 1])
    policy = Policy.load(run / "policy")
    for number in (0, 1):
        their_env.reset(seed=number)
        episode = their_env._eval_episode
        assert episode is not None
        actor = PolicyActor(policy, n_action_steps=2)
        outcome = rollout([their_env.env], actor, [episode.goal], seeds=[number], max_steps=12)[0]
        assert outcome.episode is not None
        # two rows there, one here: float32 sums in another order, over 12 steps
        np.testing.assert_allclose(done["action"][number][:12].numpy(), outcome.episode.action, atol=1e-4)


@pytest.mark.slow
def test_a_config_says_what_the_policy_reads(run: Path, kind: str, tmp_path: Path) -> None:
    export_policy(run, tmp_path / "out")
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert config["type"] == "playlearn"
    assert {key for key in config["input_features"] if "goal" in key} == GOALS[kind][1]
    assert config["output_features"] == {"action": {"type": "ACTION", "shape": [3]}}
    with pytest.raises(UsageError, match="already exists"):
        export_policy(run, tmp_path / "out")


def test_a_dataset_without_goals_is_refused() -> None:
    from playlearn.lerobot.configuration_playlearn import PlaylearnConfig

    config = PlaylearnConfig(device="cpu", input_features={"observation.state": _feature(4)})
    with pytest.raises(UsageError, match="export lerobot STORE OUT --goals"):
        config.validate_features()


def test_a_world_is_named_by_its_suite() -> None:
    from lerobot.envs.configs import EnvConfig

    from playlearn.lerobot.env import PlaylearnEnvConfig

    assert EnvConfig.get_choice_class("playlearn") is PlaylearnEnvConfig
    with pytest.raises(UsageError, match=r"--env.suite names no suite"):
        PlaylearnEnvConfig()


def _feature(size: int) -> Any:
    from lerobot.configs import FeatureType, PolicyFeature

    return PolicyFeature(type=FeatureType.STATE, shape=(size,))


@pytest.mark.slow
def test_it_learns_from_lerobots_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.policies.factory import make_policy

    import datasets
    from playlearn.lerobot.configuration_playlearn import PlaylearnConfig
    from playlearn.lerobot.goals import RelabelConfig
    from playlearn.lerobot.share import contents
    from playlearn.store.lerobot.export import write_lerobot
    from tests.synthetic import make_store

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", str(tmp_path / "cache"))
    store = make_store(tmp_path / "play", np.random.default_rng(0), 2, 100, ("front", "wrist"))
    write_lerobot(contents(store, RelabelConfig()), tmp_path / "goals")
    recipe = tmp_path / "recipe.yaml"
    block = {"encoder": small("cnn"), "trunk": small("mlp"), "head": small("deterministic"), "chunk": 4}
    recipe.write_text(json.dumps({"policy": block}))
    config = PlaylearnConfig(device="cpu", recipe=str(recipe), optimizer_lr=1e-2)
    ahead = [step / 20 for step in config.action_delta_indices]
    data = LeRobotDataset("local/goals", root=tmp_path / "goals", delta_timestamps={"action": ahead})
    policy = make_policy(config, ds_meta=data.meta)
    policy.train()
    batch = next(iter(torch.utils.data.DataLoader(data, 8)))
    optimizer = config.get_optimizer_preset().build(policy.get_optim_params())
    losses = []
    for _ in range(30):
        loss, parts = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss))
    # Eight frames in a row look alike, and their actions are noise: only what these have in common can be learned.
    assert losses[-1] < 0.9 * losses[0]
    assert all(isinstance(value, float) for value in parts.values())
    # Its inputs equal those of our own batch: the same images, and the data's mean in the normalizer.
    shown = policy._inputs(batch)
    np.testing.assert_array_equal(shown.images["front"][0, 0].numpy(), store.read(0).images["front"][0])
    mean = store.array(0, "observation.state")
    assert np.abs(policy.policy.normalizer.get_buffer("state_mean").numpy() - mean.mean(axis=0)).max() < 0.2
    assert policy.predict_action_chunk(batch).shape == (8, 4, 4)


def test_a_fresh_policy_takes_a_datasets_names_from_any_form(tmp_path: Path) -> None:
    """A mapping of names to indices in another order, as LeRobot's gamepad writes it, and no names at all."""
    from types import SimpleNamespace

    from lerobot.configs.types import FeatureType, PolicyFeature

    from playlearn.lerobot.configuration_playlearn import ACHIEVED, STATE, PlaylearnConfig
    from playlearn.lerobot.goals import GOAL_STATE
    from playlearn.lerobot.modeling_playlearn import PlaylearnPolicy

    rows = {STATE: 3, "action": 3, ACHIEVED: 4, GOAL_STATE: 2}
    numbers = {key: np.random.default_rng(0).normal(size=(20, size)).tolist() for key, size in rows.items()}
    described = {
        STATE: vector(None, 3),
        "action": vector({"gripper": 2, "dx": 0, "dy": 1}, 3),
        ACHIEVED: vector({"axes": ["x", "y", "goal.x", "goal.y"]}, 4),
        GOAL_STATE: vector([["goal.x", "goal.y"]], 2),
    }
    root = write_dataset(tmp_path / "made", described, numbers, [20])
    stats = {key: {name: np.full(size, 0.5) for name in ("mean", "std", "min", "max")} for key, size in rows.items()}
    meta = SimpleNamespace(root=root, fps=20, features=described, camera_keys=[])
    config = PlaylearnConfig(input_features={GOAL_STATE: PolicyFeature(FeatureType.STATE, (2,))}, device="cpu")
    spec = PlaylearnPolicy(config, stats, meta).policy.spec
    assert spec.state_names == ("state.0", "state.1", "state.2")
    assert spec.action_names == ("dx", "dy", "gripper")
    assert spec.achieved_names == ("x", "y")
