"""Laws of a diagnosis, in the point environment."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from playlearn.config import to_dict
from playlearn.data import DataConfig
from playlearn.errors import CheckpointError
from playlearn.evaluation import MultiChangeConfig, SuiteConfig
from playlearn.evaluation.action_error import action_errors
from playlearn.evaluation.diagnosis import _by_expert_seconds, diagnose, format_summary
from playlearn.evaluation.failure_modes import FAILURE_MODES, LEFT, MISSED, NEVER
from playlearn.evaluation.worker import EpisodeResult
from playlearn.policies import Policy, PolicyConfig
from playlearn.privileges import Privileges
from tests.evaluation.parts import play, spec
from tests.evaluation.test_failure_modes import CorrectableEnv, HandConfig, hand_expert

torch.set_num_threads(1)

SUITE = SuiteConfig(
    name="point_multi_change",
    environment=HandConfig(),
    kind=MultiChangeConfig(changes=(1,)),
    episodes=6,
    max_steps=40,
    num_envs=4,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained policy, with the play that it would have been trained on."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    play(folder.parent / "play")
    PolicyConfig(chunk=8).build(spec(CorrectableEnv), None, seed=0).save(folder / "policy")
    data = DataConfig(chunk=8, val_fraction=0.25)
    config = {"store": str(folder.parent / "play"), "data": to_dict(data), "seed": 0}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    return folder


def suite(folder: Path) -> Path:
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump(to_dict(SUITE)))
    return path


@pytest.mark.slow
def test_every_failure_has_one_mode_and_the_expert_is_evaluated_too(tmp_path: Path, run: Path) -> None:
    """Each failure is counted once; the expert reaches the policy's goals; everything is written."""
    results = diagnose(run, suite(tmp_path), tmp_path / "out", goal="state", workers=0, expert=hand_expert)
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text()) == results
    failures = results["episodes"] - round(results["success_rate"] * results["episodes"])
    assert failures > 0, "an untrained policy cannot do this"
    assert str(Privileges.from_dict(results["privileged"])) in (tmp_path / "out" / "diagnosis.html").read_text()
    assert set(results["failure_modes"]) == set(FAILURE_MODES)
    assert sum(row["count"] for row in results["failure_modes"].values()) == len(results["failures"]) == failures
    assert sum(row["fraction"] for row in results["failure_modes"].values()) == pytest.approx(1.0)
    named = Counter(row["failure_mode"] for row in results["failures"])
    assert {
        failure_mode: row["count"] for failure_mode, row in results["failure_modes"].items() if row["count"]
    } == dict(named)
    assert results["failure_modes"][LEFT]["count"] == 0, "an untrained policy never reaches a goal"
    assert results["expert"]["success_rate"] == 1.0
    assert sum(row["episodes"] for row in results["by_expert_seconds"]) == 6
    page = (tmp_path / "out" / "diagnosis.html").read_text()
    assert all(f'data-failure-mode="{failure_mode}"' in page for failure_mode in FAILURE_MODES)
    shown = {failure_mode for failure_mode in named if failure_mode in (NEVER, MISSED)}
    assert page.count('class="strip lost"') >= len(shown)
    text = format_summary(results)
    assert all(failure_mode in text for failure_mode in named)
    assert "expert 100.0%" in text


@pytest.mark.slow
def test_the_errors_of_the_skills_average_to_the_total_error(run: Path) -> None:
    """Weighted by how many examples each has, and of the first action alone; the largest comes first."""
    errors = action_errors(run)
    rows = errors["skills"]
    assert sum(row["examples"] for row in rows.values()) == errors["examples"] > 0
    assert [row["error"] for row in rows.values()] == sorted((row["error"] for row in rows.values()), reverse=True)
    assert set(rows) <= {"fetch", "carry", "press", "rest"}
    store = play(run.parent / "again")
    dataset = DataConfig(chunk=8, val_fraction=0.25).build(store, "val", 0)
    batch = dataset.batch(0, np.arange(len(dataset)))
    with torch.no_grad():
        policy = Policy.load(run / "policy").eval()
        planned = policy.act(batch, torch.Generator().manual_seed(0))
    spread = policy.normalizer.get_buffer("action_std")
    whole = float(((planned - batch.action) / spread)[:, 0].abs().mean())
    weighted = sum(row["error"] * row["examples"] for row in rows.values()) / errors["examples"]
    assert weighted == pytest.approx(whole, rel=1e-4)


def test_what_cannot_be_measured_has_a_note(tmp_path: Path, run: Path) -> None:
    other = tmp_path / "run"
    Policy.load(run / "policy").save(other / "policy")
    assert action_errors(other)["note"] == "not measured: the run's play is not there"
    raw = yaml.safe_load((run / "config.yaml").read_text())
    raw["data"]["val_fraction"] = 0.0
    (other / "config.yaml").write_text(yaml.safe_dump(raw))
    assert action_errors(other)["note"] == "not measured: the run held no play out"
    with pytest.raises(CheckpointError, match="there is no run at"):
        diagnose(tmp_path / "nowhere", suite(tmp_path), tmp_path / "out", goal="state", expert=hand_expert)
    assert not (tmp_path / "out").exists()


def test_success_by_the_time_that_the_expert_takes() -> None:
    """Eight goals the expert did in 1 to 8 s and a ninth that it did not: four bins of two; the quick ones succeed."""

    def row(policy: str, episode: int, success: bool, steps: int) -> EpisodeResult:
        return EpisodeResult(policy, episode, "t", success, success, steps, "", 0, 0)

    its = [row("expert", e, e < 8, 10 * (e + 1)) for e in range(9)]
    mine = [row("policy", e, e < 3, 5) for e in range(9)]
    bins = _by_expert_seconds(mine, its, 10.0)
    assert [(b["from"], b["to"], b["episodes"]) for b in bins] == [(1, 2, 2), (3, 4, 2), (5, 6, 2), (7, 8, 2)]
    assert [b["success_rate"] for b in bins] == [1.0, 0.5, 0.0, 0.0]
    assert _by_expert_seconds(mine, [replace(one, success=False) for one in its], 10.0) == []
