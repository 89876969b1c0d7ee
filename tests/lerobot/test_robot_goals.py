"""Under LeRobot, a goal that is the robot's own pose is given as one; what is not finite is not learned from."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from safetensors.torch import load_file, save_file

from playlearn.errors import CheckpointError, StoreError, TrainingDiverged, UsageError
from playlearn.lerobot.goals import RelabelConfig, Windows
from playlearn.lerobot.publish import export_policy
from playlearn.store import open_store
from tests.policies.parts import SPEC, H, S, policy, small, spreads
from tests.training.test_robot_goals import moving_robot

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # LeRobot's and the packages' below it
PROPRIO = "observation.goal.proprio"


@pytest.fixture(scope="module")
def robot_only(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose goal is the robot's own pose: its play records no objects."""
    config = policy(encoder_options={"goal_proprio": True}).config
    statistics = {**spreads(), "achieved": replace(spreads()["achieved"], mean=np.zeros(0), std=np.zeros(0))}
    folder = tmp_path_factory.mktemp("run")
    config.build(replace(SPEC, achieved_names=()), statistics, seed=0).save(folder / "policy")
    return folder


@pytest.fixture(scope="module")
def exported(robot_only: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported") / "out"
    export_policy(robot_only, out)
    return out


def loaded(exported: Path) -> Any:
    from playlearn.lerobot.modeling_playlearn import PlaylearnPolicy

    return PlaylearnPolicy.from_pretrained(exported, strict=True)


def observed(**more: torch.Tensor) -> dict[str, torch.Tensor]:
    return {"observation.state": torch.zeros(2, S), **more}


def test_the_goal_is_read_and_is_not_the_present_state(exported: Path) -> None:
    inputs = json.loads((exported / "config.json").read_text())["input_features"]
    assert {key: feature["shape"] for key, feature in inputs.items()} == {"observation.state": [S], PROPRIO: [S]}
    card = (exported / "README.md").read_text()
    assert "| observation | `observation.state` |" in card
    assert f"| goal | `{PROPRIO}` |" in card
    assert "| privileged information | unknown |" in card, "its run has no record"
    policy, goal = loaded(exported), torch.ones(2, S)
    here = policy.predict_action_chunk(observed(**{PROPRIO: torch.zeros(2, S)}))
    there = policy.predict_action_chunk(observed(**{PROPRIO: goal}))
    assert here.shape == (2, H, 3)
    assert not torch.equal(here, there)
    policy.reset()
    assert torch.equal(policy.select_action(observed(**{PROPRIO: goal})), there[:, 0])
    # An environment that also shows objects, which the policy does not know.
    objects = {"observation.environment_state": torch.ones(2, 6), "observation.goal.state": torch.ones(2, 3)}
    assert torch.equal(policy.predict_action_chunk(observed(**{PROPRIO: goal}, **objects)), there)


def test_what_is_not_given_or_of_another_shape_is_named(exported: Path) -> None:
    policy = loaded(exported)
    with pytest.raises(UsageError, match=rf"the policy reads {PROPRIO}, and it is not among observation.state"):
        policy.predict_action_chunk(observed())
    with pytest.raises(UsageError, match=rf"trained on {PROPRIO} of shape \(3,\), here it is \(7,\)"):
        policy.predict_action_chunk(observed(**{PROPRIO: torch.zeros(2, 7)}))


def test_an_export_without_its_goal_is_refused(exported: Path, tmp_path: Path) -> None:
    """As they were written before."""
    config = json.loads((exported / "config.json").read_text())
    del config["input_features"][PROPRIO]
    for path in exported.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(UsageError, match=rf"no input {PROPRIO}.*export it again"):
        loaded(tmp_path)


def test_a_policy_that_diverged_is_not_exported(robot_only: Path, tmp_path: Path) -> None:
    file = tmp_path / "run" / "policy" / "policy.safetensors"
    file.parent.mkdir(parents=True)
    (file.parent / "policy.json").write_bytes((robot_only / "policy" / "policy.json").read_bytes())
    weights = load_file(robot_only / "policy" / "policy.safetensors")
    weights["encoder.goal_flag"][0, 0] = torch.nan
    save_file(weights, file)
    with pytest.raises(CheckpointError, match="diverged"):
        export_policy(tmp_path / "run", tmp_path / "out")


@pytest.fixture(scope="module")
def relabeled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Play of a robot alone as a LeRobot dataset with goals, and the recipe of a policy beside it."""
    from playlearn.store.lerobot.export import write_lerobot

    home = tmp_path_factory.mktemp("relabeled")
    write_lerobot(Windows(open_store(moving_robot(home / "play", objects=False)), RelabelConfig()), home / "goals")
    block = {"encoder": small("state", goal_proprio=True), "trunk": small("mlp"), "head": small("deterministic")}
    (home / "recipe.yaml").write_text(json.dumps({"policy": {**block, "chunk": 4}}))
    return home


@pytest.fixture
def fresh(relabeled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Any, Any]]:
    import datasets

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", str(tmp_path / "cache"))

    def make(recipe: str | None = None, change: Callable[[Any], None] = lambda _: None) -> tuple[Any, Any]:
        """As lerobot-train makes it: the policy and the first batch."""
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
        from lerobot.policies.factory import make_policy

        from playlearn.lerobot.configuration_playlearn import PlaylearnConfig

        config = PlaylearnConfig(device="cpu", recipe=recipe or str(relabeled / "recipe.yaml"))
        ahead = [step / 20 for step in config.action_delta_indices]
        data = LeRobotDataset("local/goals", root=relabeled / "goals", delta_timestamps={"action": ahead})
        change(data.meta)
        return make_policy(config, ds_meta=data.meta), next(iter(torch.utils.data.DataLoader(data, 8)))

    return make


def test_it_learns_from_lerobots_batches(relabeled: Path, fresh: Callable[..., tuple[Any, Any]]) -> None:
    policy, batch = fresh()
    windows = Windows(open_store(relabeled / "play"), RelabelConfig())
    goal = windows.store.read(0).state[windows.windows[0].goal]
    np.testing.assert_array_equal(policy._inputs(batch).goal_proprio[0].numpy(), goal)
    assert policy.train().forward(batch)[0].isfinite()
    assert PROPRIO in policy.config.input_features


def test_a_batch_that_is_not_finite_is_named_by_its_frame(fresh: Callable[..., tuple[Any, Any]]) -> None:
    policy, batch = fresh()
    batch["observation.state"][5, 1] = torch.nan
    with pytest.raises(TrainingDiverged, match=r"loss is nan; .* to blame: state eef.y is nan in episode 0, frame 5$"):
        policy.train().forward(batch)


def test_weights_that_are_not_finite_are_not_saved(fresh: Callable[..., tuple[Any, Any]], tmp_path: Path) -> None:
    policy, batch = fresh()
    policy.save_pretrained(tmp_path / "saved")
    with torch.no_grad():
        policy.policy.encoder.goal_flag.fill_(torch.inf)
    with pytest.raises(TrainingDiverged, match=r"encoder.goal_flag is not finite; .*other is not written"):
        policy.save_pretrained(tmp_path / "other")
    with pytest.raises(TrainingDiverged, match="its data are finite, so its updates are too large"):
        policy.train().forward(batch)


def test_what_only_training_reads_is_asked_for_then(tmp_path: Path) -> None:
    """Images that are supervised with `achieved`, and goals of either kind: acting needs less than training."""
    options = {"goal": "both", "state_supervision": 1.0, "use_estimated_state": True}
    policy("cnn", encoder_options=options).save(tmp_path / "run" / "policy")
    export_policy(tmp_path / "run", tmp_path / "out")
    ours = loaded(tmp_path / "out")
    images = {f"observation.images.{name}": torch.zeros(2, 3, 16, 16) for name in ("front", "wrist", "goal_front")}
    seen = observed(**images)
    assert ours.predict_action_chunk(seen).shape == (2, H, 3)
    told = {**seen, "observation.goal.state": torch.zeros(2, 4), "observation.environment_state": torch.zeros(2, 8)}
    del told["observation.images.goal_front"]
    assert ours.predict_action_chunk(told).shape == (2, H, 3)
    ours.reset()
    assert ours.select_action(told).shape == (2, 3)
    with pytest.raises(UsageError, match=r"the policy reads observation\.environment_state, and it is not among"):
        ours.train().forward({**seen, "action": torch.zeros(2, H, 3)})
    loss, _ = ours.forward({**seen, **told, "action": torch.zeros(2, H, 3)})
    assert loss.isfinite()


def test_images_that_are_scaled_otherwise_are_named(tmp_path: Path) -> None:
    policy("cnn").save(tmp_path / "run" / "policy")
    export_policy(tmp_path / "run", tmp_path / "out")
    ours = loaded(tmp_path / "out")
    names = ("front", "wrist", "goal_front")
    seen = observed(**{f"observation.images.{name}": torch.rand(2, 3, 16, 16) for name in names})
    there = ours.predict_action_chunk(seen)
    whole = {key: (255 * value).to(torch.uint8) if ".images." in key else value for key, value in seen.items()}
    assert ours.predict_action_chunk(whole).shape == there.shape
    goal = "observation.images.goal_front"
    for wrong, said in ((255 * seen[goal], "255"), ((seen[goal] - 0.5) / 0.2, "-2.5")):
        with pytest.raises(UsageError, match=rf"{goal} is between .*{said[:-1]}.*numbers from 0 to 1, or uint8"):
            ours.predict_action_chunk({**seen, goal: wrong})
    gray = {**seen, goal: seen[goal][:, :1]}
    with pytest.raises(UsageError, match=rf"trained on {goal} of shape \(3, 16, 16\), here it is \(1, 16, 16\)"):
        ours.predict_action_chunk(gray)


def test_what_the_dataset_cannot_give_is_refused(
    relabeled: Path, fresh: Callable[..., tuple[Any, Any]], tmp_path: Path
) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(json.dumps({"policy": {"encoder": small("state")}}))
    with pytest.raises(UsageError, match=r"`policy.encoder.goal_proprio: true`"):
        fresh(str(recipe))

    def older(meta: Any) -> None:
        """As they were exported before: under the name of the objects in a goal."""
        meta.info.features["observation.goal.state"] = meta.info.features.pop(PROPRIO)

    with pytest.raises(UsageError, match=f"the policy reads {PROPRIO}, which the dataset lacks: write it with"):
        fresh(change=older)

    damaged = Path(shutil.copytree(relabeled, tmp_path / "damaged")) / "goals"
    for path in damaged.glob("data/*/*.parquet"):
        rows = pq.read_table(path)
        state = np.stack(rows["observation.state"].to_numpy()).astype(np.float32)
        state[3, 2] = np.nan
        column = pa.FixedSizeListArray.from_arrays(pa.array(state.ravel()), state.shape[1])
        pq.write_table(
            rows.set_column(rows.schema.get_field_index("observation.state"), "observation.state", column), path
        )

    def elsewhere(meta: Any) -> None:
        meta.root = damaged

    with pytest.raises(StoreError, match=r"damaged/goals: observation.state: eef.z is nan in row 3"):
        fresh(change=elsewhere)
