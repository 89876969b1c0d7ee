"""LeRobot's own commands on our exports; in this process if possible, as they are slow to import."""

import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.lerobot.goals import RelabelConfig
from playlearn.lerobot.share import contents
from playlearn.store import LeRobotStoreConfig, NativeStore
from playlearn.store.lerobot.export import write_lerobot
from tests.synthetic import make_store

pytestmark = pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix
CAMERAS = {"front": (48, 64), "wrist": (48, 48)}


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(autouse=True)
def apart(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder for LeRobot's cache, instead of the user's."""
    import datasets

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", str(home / "cache"))


@pytest.fixture(scope="module")
def store(home: Path) -> NativeStore:
    return make_store(home / "play", np.random.default_rng(0), 4, 100, CAMERAS)


@pytest.fixture(scope="module")
def plain(store: NativeStore, home: Path) -> Path:
    write_lerobot(contents(store), home / "plain", videos="h264")
    return home / "plain"


@pytest.fixture(scope="module")
def goals(store: NativeStore, home: Path) -> Path:
    write_lerobot(contents(store, RelabelConfig()), home / "goals")
    return home / "goals"


def edit(monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
    """`lerobot-edit-dataset --name=value ...`"""
    from lerobot.scripts import lerobot_edit_dataset

    arguments = [f"--{name.replace('operation_', 'operation.')}={value}" for name, value in settings.items()]
    monkeypatch.setattr(sys, "argv", ["lerobot-edit-dataset", *arguments])
    monkeypatch.setattr(lerobot_edit_dataset, "init_logging", lambda: None)
    lerobot_edit_dataset.main()


@pytest.mark.slow
def test_it_is_split_and_merged_and_read_again(
    plain: Path, store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fractions = json.dumps({"one": 0.5, "other": 0.5})
    edit(
        monkeypatch,
        repo_id="local/plain",
        root=plain,
        new_root=tmp_path / "split",
        operation_type="split",
        operation_splits=fractions,
    )
    parts = [tmp_path / "split" / name for name in ("one", "other")]
    edit(
        monkeypatch,
        new_repo_id="local/merged",
        new_root=tmp_path / "merged",
        operation_type="merge",
        operation_repo_ids=json.dumps(["local/one", "local/other"]),
        operation_roots=json.dumps([str(part) for part in parts]),
    )
    back = LeRobotStoreConfig(root=tmp_path / "merged", cache=tmp_path / "frames").build()
    assert len(back) == 4  # by LeRobot's hand, so without what stood beside: a step shorter
    for i in range(4):
        np.testing.assert_array_equal(back.array(i, "action"), store.array(i, "expert_action")[:-1])
        seen, shown = back.array(i, "observation.images.front"), store.array(i, "observation.images.front")[:-1]
        assert np.square(seen.astype(float) - shown).mean() < 255**2 / 10**2.5  # 25 dB, as the film was written


@pytest.mark.slow
def test_its_info_is_printed(plain: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    edit(monkeypatch, repo_id="local/plain", root=plain, operation_type="info")
    output = capsys.readouterr().out
    assert "Total episode: 4" in output
    assert "Total frame(Actual Count): 400(400)" in output


@pytest.mark.slow
def test_it_can_be_visualized(plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.scripts import lerobot_dataset_viz

    arguments = [
        f"--root={plain}",
        "--repo-id=local/plain",
        "--episode-index=1",
        "--save=1",
        f"--output-dir={tmp_path}",
    ]
    monkeypatch.setattr(sys, "argv", ["lerobot-dataset-viz", *arguments, "--num-workers=0"])
    monkeypatch.setattr(lerobot_dataset_viz, "init_logging", lambda: None)
    lerobot_dataset_viz.main()
    assert next(tmp_path.glob("*.rrd")).stat().st_size > 10_000


def run(command: str, *arguments: str, home: Path) -> str:
    """The output of a command in its own process."""
    done = subprocess.run(
        [Path(sys.executable).with_name(command), *arguments],
        env={**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(home), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=6000,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stderr + done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["act", "playlearn"])
def test_it_is_trained_on(
    goals: Path, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """lerobot-train, unmodified: the goal is one more camera to its own policies.

    Ours is trained in a process of its own, in which nobody but LeRobot itself can have found it.
    """
    settings: dict[str, Any] = {
        "dataset.repo_id": "local/goals",
        "dataset.root": goals,
        "policy.type": kind,
        "policy.push_to_hub": "false",
        "policy.device": "cpu",
        "num_workers": 0,
        "steps": 2,
        "batch_size": 2,
        "log_freq": 1,
        "output_dir": tmp_path / "run",
    }
    own = {
        "act": {
            "pretrained_backbone_weights": "null",
            "dim_model": 32,
            "n_heads": 2,
            "dim_feedforward": 64,
            "chunk_size": 4,
            "n_action_steps": 4,
        },
        "playlearn": {"discover_packages_path": "playlearn.lerobot.plugins"},  # where the package is not installed
    }
    settings |= {f"policy.{name}": value for name, value in own[kind].items()}
    arguments = [f"--{name}={value}" for name, value in settings.items()]
    if kind == "act":
        from lerobot.scripts import lerobot_train

        monkeypatch.setattr(sys, "argv", ["lerobot-train", *arguments])
        monkeypatch.setattr(lerobot_train, "init_logging", lambda **_: None)
        with caplog.at_level(logging.INFO):
            lerobot_train.main()
        output = caplog.text
    else:
        output = run("lerobot-train", *arguments, home=tmp_path / "home")
    losses = [float(value) for value in re.findall(r"loss:([\d.]+) grdn", output)]
    assert len(losses) == 2  # one line a step
    assert np.isfinite(losses).all()
    saved = next((tmp_path / "run" / "checkpoints").glob("*/pretrained_model/config.json"))
    assert (saved.parent / "model.safetensors").is_file()
    if kind == "act":
        assert "observation.images.goal_front" in json.loads(saved.read_text())["input_features"]
