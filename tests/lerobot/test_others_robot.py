"""A robot of somebody else, whose numbers are degrees: its play, a policy of it, and LeRobot's evaluation of that."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from playlearn.cli import main
from tests.lerobot_dataset import vector, write_dataset

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # LeRobot's and the packages' below it
CONFIG = Path(__file__).parents[2] / "configs" / "train" / "lerobot.yaml"
EPISODES = 8


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tests.lerobot.so100_env import play
    from tests.lerobot.so100_env.env import NAMES

    rng = np.random.default_rng(0)
    played = [play(rng) for _ in range(24)]
    states, actions = (np.concatenate(part) for part in zip(*played, strict=True))
    features = {"observation.state": vector(list(NAMES)), "action": vector(list(NAMES))}
    columns = {"observation.state": states, "action": actions}
    root = tmp_path_factory.mktemp("recorded") / "so100"
    return write_dataset(root, features, columns, [len(state) for state, _ in played])


def test_its_poses_are_reached_under_lerobots_own_command(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Imported, learned from by the documented config, exported: a goal is another pose than the present one."""
    assert main(["import", "lerobot", str(recorded), str(tmp_path / "play")]) == 0
    settings = ["--policy.encoder.goal_proprio=true", "--steps=250", "--batch_size=64", "--cpu=true"]
    settings += [f"--store={tmp_path / 'play'}"]
    assert main(["train", "--config", str(CONFIG), "--out", str(tmp_path / "run"), *settings]) == 0
    assert main(["export", "policy", str(tmp_path / "run"), str(tmp_path / "policy")]) == 0
    assert success_rate(tmp_path / "policy", tmp_path / "eval", monkeypatch) == 1.0


def success_rate(policy: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> float:
    """Of `lerobot-eval`, unmodified."""
    from lerobot.scripts import lerobot_eval

    settings = {
        "policy.path": policy,
        "env.type": "so100",
        "env.discover_packages_path": "tests.lerobot.so100_env",
        "eval.n_episodes": EPISODES,
        "eval.batch_size": EPISODES,
        "output_dir": out,
    }
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *(f"--{name}={value}" for name, value in settings.items())])
    monkeypatch.setattr(lerobot_eval, "init_logging", lambda: None)
    lerobot_eval.main()
    return float(json.loads((out / "eval_info.json").read_text())["overall"]["pc_success"]) / 100
