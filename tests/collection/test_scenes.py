"""Laws of scenes that a simulator draws for an image encoder to learn from."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from playlearn.collection.scenes import render_scenes, render_scenes_of
from playlearn.config import from_dict
from playlearn.data import Scenes, ScenesConfig, mix_datasets
from playlearn.data.split import val_episodes
from playlearn.envs import PlayTableConfig, StackConfig
from playlearn.envs.playtable.layout import BLOCK_NAMES, block
from playlearn.errors import UsageError
from playlearn.policies import Policy
from playlearn.store import NativeStore, open_store
from playlearn.training import TrainConfig, train
from tests.evaluation.parts import play
from tests.synthetic import make_store

torch.set_num_threads(1)
CAMERAS = ("front", "wrist")
EACH = 6


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    """Play of PointEnv, recorded without images."""
    path = tmp_path_factory.mktemp("scenes") / "play"
    play(path)
    return NativeStore.open(path)


def drawn(store: NativeStore, folder: Path, out: list[int], **more: float) -> Scenes:
    config = ScenesConfig(per_episode=EACH, **more)  # type: ignore[arg-type]
    val_mask = np.isin(np.arange(len(store)), out)
    render_scenes(config, store, val_mask, CAMERAS, folder, workers=0)  # other processes do not know this environment
    return shown(store, folder)


def shown(store: NativeStore, folder: Path) -> Scenes:
    return Scenes(folder, store.indices(), cameras=CAMERAS, goal_cameras=("front",), labels=(4, 3), seed=0)


def test_scenes_of_an_episode_do_not_depend_on_who_draws_what_before(store: NativeStore, tmp_path: Path) -> None:
    """So that any number of workers leaves the same files."""
    single = drawn(store, tmp_path / "single", [0])
    names = sorted(path.name for path in (tmp_path / "single" / "episodes").iterdir())
    assert len(names) == len(store)
    assert len(single) == EACH * len(store)
    whole = {name: (tmp_path / "single" / "episodes" / name).read_bytes() for name in names}
    for position in reversed(range(len(store))):
        rearranged = 0.0 if position == 0 else 0.5
        render_scenes_of(str(store.path), str(tmp_path / "single"), int(store.indices()[position]), rearranged)
    assert {name: (tmp_path / "single" / "episodes" / name).read_bytes() for name in names} == whole


def test_an_interrupted_drawing_goes_on_and_other_settings_are_refused(store: NativeStore, tmp_path: Path) -> None:
    drawn(store, tmp_path / "drawn", [0])
    whole = {path.name: path.read_bytes() for path in (tmp_path / "drawn" / "episodes").iterdir()}
    first = min((tmp_path / "drawn" / "episodes").iterdir())
    first.unlink()
    drawn(store, tmp_path / "drawn", [0])
    assert {path.name: path.read_bytes() for path in (tmp_path / "drawn" / "episodes").iterdir()} == whole
    with pytest.raises(UsageError, match="begun with another rearranged"):
        drawn(store, tmp_path / "drawn", [0], rearranged=0.1)


def test_held_out_scenes_stay_as_they_were_recorded(store: NativeStore, tmp_path: Path) -> None:
    """Of the others every object is placed anew; in all of them the robot stays where it was."""
    scenes = drawn(store, tmp_path / "drawn", [1], rearranged=1.0)
    for i in range(len(store)):
        mine = slice(EACH * i, EACH * (i + 1))
        pucks, hands = store.array(i, "achieved")[:, :2], store.array(i, "observation.state")
        recorded = [(np.abs(pucks - puck).max(1) < 1e-6).any() for puck in scenes.achieved[mine, :2]]
        assert all(recorded) if i == 1 else not any(recorded)
        assert all((np.abs(hands - hand).max(1) < 1e-6).any() for hand in scenes.state[mine])


def test_a_batch_of_scenes_teaches_no_action_and_each_is_its_own_goal(store: NativeStore, tmp_path: Path) -> None:
    scenes = drawn(store, tmp_path / "drawn", [])
    batch = scenes.batch(np.array([3, 0, 11]))
    assert not batch.action_mask.any()
    assert batch.images["front"].data_ptr() == batch.goal_images["front"].data_ptr()
    torch.testing.assert_close(batch.achieved[:, 0], batch.goal_achieved)
    np.testing.assert_array_equal(batch.achieved[:, 0].numpy(), scenes.achieved[[3, 0, 11]])
    seen = sorted(np.concatenate([scenes.epoch_indices(epoch) for epoch in (0, 1)]).tolist())
    assert seen == sorted([*range(len(scenes)), *range(len(scenes))]), "each once an epoch"


def test_play_and_scenes_mix(store: NativeStore, tmp_path: Path) -> None:
    """Play brings no keypoints: NaN stands for them."""
    images = tmp_path / "images"
    make_store(images, np.random.default_rng(0), episodes=3, steps=120, cameras={"front": (24, 32), "wrist": (16, 16)})
    config = from_dict(
        TrainConfig, {"store": str(images), "policy": {"encoder": {"type": "cnn"}, "chunk": 4}}
    ).resolved()
    own = config.data.build(open_store(images), "train", 0)
    scenes = drawn(store, tmp_path / "drawn", [])
    scenes.state, scenes.achieved = np.zeros((len(scenes), 4), np.float32), np.zeros((len(scenes), 7), np.float32)
    scenes._shape = 4, 4
    batch = next(mix_datasets(own, [(scenes, 0.25)]).batches(16))
    assert batch.action_mask.any(dim=1).sum() >= 8
    assert (~batch.action_mask.any(dim=1)).sum() >= 4
    assert torch.isnan(batch.keypoints["front"]).flatten(1).all(dim=1).sum() in (0, 12, 16)


@pytest.mark.slow
def test_an_encoder_is_trained_from_a_store_without_images(store: NativeStore, tmp_path: Path) -> None:
    """Only the encoder moved; its held-out loss is of held-out episodes' scenes."""
    held = np.flatnonzero(val_episodes(store.indices(), 0.5)).tolist()
    drawn(store, tmp_path / "drawn", held)
    config = from_dict(
        TrainConfig,
        {
            "store": str(store.path),
            "trainable": ["encoder.front.*", "encoder.others.*", "encoder.estimate.*"],
            "scenes": {"per_episode": EACH, "folder": str(tmp_path / "drawn")},
            "policy": {
                "encoder": {
                    "type": "keypoints",
                    "channels": [4],
                    "kernels": [4],
                    "strides": [4],
                    "features": 8,
                    "hidden": 8,
                    "heatmaps": 2,
                    "fusion": "late",
                    "state_supervision": 1.0,
                    "use_estimated_state": True,
                    "feed_cameras": [],
                },
                "trunk": {"type": "mlp", "width": 16},
                "chunk": 4,
            },
            "data": {"val_fraction": 0.5},
            "batch_size": 8,
            "steps": 4,
            "warmup": 1,
            "ema_decay": 0.0,
            "val_every": 2,
            "cpu": True,
        },
    )
    train(config, tmp_path / "run")
    moved = Policy.load(tmp_path / "run" / "policy").state_dict()
    fresh = dataclasses.replace(config, steps=5)
    train(fresh, tmp_path / "run", resume=True)
    later = Policy.load(tmp_path / "run" / "policy").state_dict()
    changed = {name for name in moved if not torch.equal(moved[name], later[name])}
    assert changed
    assert all(name.startswith(("encoder.front.", "encoder.others.", "encoder.estimate.")) for name in changed)
    assert "val/achieved" in (tmp_path / "run" / "metrics.jsonl").read_text()
    assert "val/head" not in (tmp_path / "run" / "metrics.jsonl").read_text()


def test_scenes_leave_room_for_what_else_is_shown() -> None:
    with pytest.raises(UsageError, match="leave nothing for the play"):
        from_dict(TrainConfig, {"scenes": {"fraction": 0.6}, "extra_datasets": [{"store": "x", "fraction": 0.5}]})
    with pytest.raises(UsageError, match="single moments"):
        from_dict(TrainConfig, {"scenes": {}, "policy": {"history": 2}})


@pytest.mark.slow
def test_a_camera_sees_a_block_where_it_is_projected() -> None:
    """The red pixels' mean is the projection of the red block's center, within a pixel: of 96 x 64, or of 64 x 64."""
    env = PlayTableConfig(stacked=0.0, stowed=0.0, shelved=0.0).build()
    env.reset(3)
    red = BLOCK_NAMES.index("red")
    env.lay(red, (0.08, -0.02), 0.3)
    env.refresh()
    center = np.array(block(env.achieved(), red)[:3], float)[None]
    image = env.render("front").astype(float)
    mask = (image[..., 0] > 110) & (image[..., 1] < 70) & (image[..., 2] < 70)
    assert 6 <= mask.sum() <= 60
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    seen = 2 * (columns.mean() + 0.5) / width - 1, 2 * (rows.mean() + 0.5) / height - 1
    np.testing.assert_allclose(env.project("front", center)[0], seen, atol=2 * 1.0 / height)
    behind = np.array([[5.0, 0.0, 3.0]])
    assert np.isnan(env.project("front", behind)).all()


@pytest.mark.slow
@pytest.mark.parametrize("config", [PlayTableConfig(), StackConfig()], ids=lambda config: type(config).__name__)
def test_objects_are_placed_anew_around_a_robot_that_stays(config: PlayTableConfig | StackConfig) -> None:
    env = config.build()
    env.reset(0)
    for action in np.random.default_rng(0).uniform(-1, 1, (20, len(env.spec.action_names))):
        env.step(action)
    before = env.observe()
    env.rearrange(np.random.default_rng(1))
    after = env.observe()
    np.testing.assert_array_equal(after.state, before.state)
    assert np.abs(after.achieved - before.achieved).max() > 0.02
