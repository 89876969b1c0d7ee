"""What a mistake costs: training tells it before anything slow is imported, and does nothing."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic import make_store

CONFIG = Path(__file__).parents[2] / "configs/train/playtable_state.yaml"
SLOW = [
    "datasets",
    "diffusers",
    "gymnasium",
    "lerobot",
    "mujoco",
    "ogbench",
    "playlearn.envs",
    "robosuite",
    "transformers",
]
MISTAKES = {
    "did you mean `layers`": ["--policy.trunk.layres", "3"],
    "difusion": ["--policy.head.type", "difusion"],
    "there is no store": ["--store", "NOWHERE"],
    "has no images of top": ["--policy.encoder.type", "cnn", "--policy.encoder.cameras", "[top, front]"],
    "matches none of: red.x": ["--policy.encoder.goal_names", "[blue]"],
    "left without a goal": ["--policy.encoder.goal_names", "[]"],
    "no policy at": ["--init_from", "NOWHERE"],
}


@pytest.mark.slow
def test_a_mistake_is_told_before_anything_slow_is_imported(tmp_path: Path) -> None:
    """No simulator, no LeRobot, no diffusers: whoever only trains waits for none and need not have it installed."""
    make_store(tmp_path / "play", np.random.default_rng(0), 2, 60)
    places = {"NOWHERE": str(tmp_path / "nowhere")}
    common = ["train", "--config", str(CONFIG), "--out", str(tmp_path / "run"), "--store", str(tmp_path / "play")]
    commands = [common + [places.get(word, word) for word in words] for words in MISTAKES.values()]
    code = (
        "import json, sys\nfrom playlearn import cli\n"
        f"print(json.dumps([[cli.main(words), [name for name in {SLOW} if name in sys.modules]] "
        f"for words in {commands}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [[2, []]] * len(MISTAKES)
    said = done.stderr.splitlines()
    assert len(said) == len(MISTAKES)
    assert [words for words, line in zip(MISTAKES, said, strict=True) if words not in line] == []
    assert not (tmp_path / "run").exists()
