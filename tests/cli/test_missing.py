"""What is named and not there is a mistake of usage, in every command: exit code 2, one line, nothing written."""

from pathlib import Path

import pytest

from playlearn import cli

ROOT = Path(__file__).parents[2]
SUITE = str(ROOT / "eval/suites/lift.yaml")
TRAIN = str(ROOT / "configs/train/playtable_state.yaml")
LEROBOT = str(ROOT / "configs/train/lerobot.yaml")
STATE = str(ROOT / "eval/pretrained/state")
COMMANDS = {
    "info": ["info", "NOWHERE"],
    "render": ["render", "NOWHERE", "OUT", "--camera", "front=16x16"],
    "view": ["view", "NOWHERE"],
    "collect, config": ["collect", "--config", "NOWHERE", "--out", "OUT"],
    "train, config": ["train", "--config", "NOWHERE", "--out", "OUT"],
    "train, store": ["train", "--config", TRAIN, "--store", "NOWHERE", "--out", "OUT"],
    "train, LeRobot": ["train", "--config", LEROBOT, "--store.root", "NOWHERE", "--out", "OUT"],
    "train, run": ["train", "--config", TRAIN, "--store", "SAMPLE", "--init_from", "NOWHERE", "--out", "OUT"],
    "eval, run": ["eval", "--run", "NOWHERE", "--suite", SUITE, "--goal", "state", "--out", "OUT"],
    "eval, suite": ["eval", "--run", STATE, "--suite", "NOWHERE", "--goal", "state", "--out", "OUT"],
    "eval, encoder": [
        *("eval", "--run", STATE, "--encoder", "NOWHERE"),
        *("--suite", SUITE, "--goal", "image", "--out", "OUT"),
    ],
    "diagnose": ["diagnose", "--run", "NOWHERE", "--suite", SUITE, "--goal", "state", "--out", "OUT"],
    "dagger, config": ["dagger", "--config", "NOWHERE", "--run", STATE, "--out", "OUT"],
    "dagger, run": [
        *("dagger", "--config", str(ROOT / "configs/dagger/playtable_state.yaml")),
        *("--run", "NOWHERE", "--out", "OUT"),
    ],
    "compare": ["compare", "--config", "NOWHERE", "--out", "OUT"],
    "demo": ["demo", "--config", "NOWHERE", "--out", "OUT"],
    "toy": ["toy", "--config", "NOWHERE", "--out", "OUT"],
    "config": ["config", "train", "--config", "NOWHERE"],
    "export lerobot": ["export", "lerobot", "NOWHERE", "OUT"],
    "export robomimic": ["export", "robomimic", "NOWHERE", "OUT"],
    "export policy": ["export", "policy", "NOWHERE", "OUT"],
    "import lerobot": ["import", "lerobot", "NOWHERE", "OUT"],
    "import robomimic": ["import", "robomimic", "NOWHERE", "OUT"],
    "import robosuite": ["import", "robosuite", "NOWHERE", "OUT"],
    "import ogbench": ["import", "ogbench", "NOWHERE", "OUT"],
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.filterwarnings("ignore")  # of packages that a command brings along
def test_what_is_not_there_is_a_mistake_of_usage(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    places = {
        "NOWHERE": str(tmp_path / "nowhere.yaml"),
        "OUT": str(tmp_path / "out"),
        "SAMPLE": str(ROOT / "datasets/sample"),
    }
    assert cli.main([places.get(word, word) for word in COMMANDS[name]]) == 2
    errors = capsys.readouterr().err.strip()
    assert "nowhere" in errors
    assert errors.count("\n") == 0
    assert list(tmp_path.iterdir()) == []
