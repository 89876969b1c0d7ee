"""What training says of a store before it begins."""

from pathlib import Path

import numpy as np

from playlearn.store import open_store
from playlearn.training import TrainConfig
from playlearn.training.examples import store_remarks
from tests.lerobot_dataset import vector, write_dataset


def test_what_is_left_out_and_where_goals_come_from_is_said(tmp_path: Path) -> None:
    rows = np.zeros((10, 2)).tolist()
    features = {"observation.state": vector(["x", "Gripper"]), "action": vector(["dx"], 2), "effort": vector(None, 2)}
    root = write_dataset(tmp_path / "made", features, dict.fromkeys(features, rows), [10])
    said = store_remarks(TrainConfig(), open_store(root))
    assert said[0].startswith("effort: left out: ")
    assert said[1].startswith("action: its `names` are 1 for 2 numbers")
    assert said[2].startswith("settled where the gripper (Gripper) has opened")
    objects = features | {"observation.environment_state": vector(["cube.x", "cube.y"])}
    root = write_dataset(tmp_path / "objects", objects, dict.fromkeys(objects, rows), [10])
    assert len(store_remarks(TrainConfig(), open_store(root))) == 2  # goals come from what is recorded
