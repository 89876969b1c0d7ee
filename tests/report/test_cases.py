"""What goals a store allows, as `playlearn info` says it."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from playlearn.cli import main
from playlearn.report.cases import CONFIGS, cases
from playlearn.store import open_store
from tests.lerobot_dataset import EPISODES, change_info
from tests.real_robot import arm, recorded
from tests.synthetic import make_store

ROOT = Path(__file__).parents[2]


def test_a_robots_recording_allows_its_pose_and_goal_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    episodes = [arm(5, 30, seed) for seed in range(2)]
    filmed = recorded(tmp_path / "filmed", episodes, cameras={"up": (8, 12), "hand": (6, 6)})
    found = cases(open_store(filmed))
    assert found["goal image"] == "cameras up 8x12, hand 6x6, as in configs/train/lerobot_image.yaml"
    assert found["robot's pose"] == "6 numbers, as in configs/train/lerobot.yaml"
    assert found["goal state"] == "not possible: no objects (`achieved`)"
    assert "settled moments" not in found
    moments = found["settled moments of the robot"]
    assert moments.startswith("2 in 2 of 2 episodes: settled where the gripper (gripper.pos) has opened")
    assert main(["info", str(filmed), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["goals"] == found

    bare = cases(open_store(recorded(tmp_path / "bare", episodes)))
    assert bare["goal image"] == "not possible: no images"


def test_play_with_objects_allows_all(tmp_path: Path) -> None:
    found = cases(make_store(tmp_path / "play", np.random.default_rng(0), 2, 120, ("front",)))
    assert found["goal state"] == "objects, 7 numbers, as in configs/train/lerobot_objects.yaml"
    assert found["settled moments"].endswith("in 2 of 2 episodes by the objects")


def test_every_config_that_is_named_is_there() -> None:
    assert all((ROOT / path).is_file() for path in CONFIGS.values())


def test_a_file_of_recordings_is_to_be_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "demo.hdf5").write_bytes(b"\x89HDF")
    assert main(["info", str(tmp_path / "demo.hdf5")]) == 2
    assert "demo.hdf5 is a file, and a store is a folder: read recordings with `playlearn" in capsys.readouterr().err


def test_a_dataset_whose_videos_are_missing_says_what_its_numbers_allow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = recorded(tmp_path / "data", [arm(5, 30, seed) for seed in range(2)])
    video = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channels"]}
    info = json.loads((root / "meta" / "info.json").read_text())
    change_info(root, features={**info["features"], "observation.images.up": video})
    places = {f"videos/observation.images.up/{name}": [0] * 2 for name in ("chunk_index", "file_index")}
    places |= {f"videos/observation.images.up/{name}_timestamp": [0.0, 5.0] for name in ("from", "to")}
    table = pq.read_table(root / EPISODES)
    for name, column in places.items():
        table = table.append_column(name, pa.array(column))
    pq.write_table(table, root / EPISODES)
    assert main(["info", str(root)]) == 1
    assert f"`playlearn info {root} --without-images`" in capsys.readouterr().err
    assert main(["info", str(root), "--without-images"]) == 0
    said = capsys.readouterr().out
    assert "not possible: no images" in said
    assert "2 in 2 of 2 episodes" in said
