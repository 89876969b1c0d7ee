"""What `lerobot-rollout --strategy.type=dagger` records is learned from as HG-DAgger does, by the documented config."""

import dataclasses
from pathlib import Path

import numpy as np

from playlearn.config import load_config
from playlearn.store import LeRobotStoreConfig, open_store
from playlearn.training import TrainConfig
from tests.lerobot_dataset import vector, write_dataset

CONFIG = Path(__file__).parents[2] / "configs/train/lerobot_corrected.yaml"
STEPS, BEGIN = 60, 40  # of a rollout; a person takes over from here on


def test_of_an_imported_rollout_only_corrections_count(tmp_path: Path) -> None:
    """Two rollouts whose last third a person drives: 20 steps each, without the last one."""
    rng = np.random.default_rng(0)
    pose = np.cumsum(rng.normal(size=(2 * STEPS, 3)), axis=0).astype(np.float32)
    took_over = np.arange(2 * STEPS) % STEPS >= BEGIN
    features = {"observation.state": vector(["x", "y", "gripper.pos"]), "action": vector(["x", "y", "gripper.pos"])}
    features["intervention"] = {"dtype": "bool", "shape": [1], "names": None}
    columns = {"observation.state": pose.tolist(), "action": pose.tolist(), "intervention": took_over}
    root = write_dataset(tmp_path / "rollout_corrected", features, columns, [STEPS, STEPS])
    source = load_config(TrainConfig, CONFIG).extra_datasets[0]
    assert source.data is not None
    assert isinstance(source.store, LeRobotStoreConfig)
    store = open_store(dataclasses.replace(source.store, root=root, without_images=True), blind=True)
    data = source.data.build(store, "train", 0)
    assert len(data) == 2 * (STEPS - BEGIN - 1)
    assert data.where(np.arange(len(data)))[1].min() == BEGIN
    batch = data.batch(0, np.arange(len(data)))
    shown = {tuple(label) for label in batch.action[batch.action_mask].tolist()}
    assert shown == {tuple(row) for row in pose[took_over].tolist()} - {tuple(pose[59]), tuple(pose[119])}
