"""A comparison: variants that differ only in fields, nothing done twice, and figures that add up."""

import json
from functools import partial
from pathlib import Path

import pytest
import yaml

import playlearn.experiments.compare
from playlearn.config import load_config, save_config
from playlearn.errors import UsageError
from playlearn.experiments.compare import CompareConfig, compare
from playlearn.report.compared import table
from playlearn.report.intervals import wilson
from tests.evaluation.parts import SUITE, play
from tests.fakes import point_expert

CONFIGS = sorted((Path(__file__).parents[2] / "configs" / "compare").glob("*.yaml"))
VARIANTS = {"plain": {}, "a mixture": {"policy.head.type": "mog", "policy.head.components": 2}}


@pytest.fixture(autouse=True)
def its_own_expert(monkeypatch: pytest.MonkeyPatch) -> None:
    """No expert is registered for PointEnv."""
    monkeypatch.setattr(
        playlearn.experiments.compare, "evaluate", partial(playlearn.experiments.compare.evaluate, expert=point_expert)
    )


def described(folder: Path, **changes: object) -> CompareConfig:
    """A few updates on a little play, two evaluation episodes, in an environment that takes milliseconds."""
    if not (folder / "play").exists():
        play(folder / "play")
        save_config(SUITE, folder / "suite.yaml")
    written = {
        "base": "configs/train/playtable_state.yaml",
        "common": {
            "store": str(folder / "play"),
            "policy.trunk.width": 16,
            "policy.trunk.layers": 1,
            "policy.encoder.hidden": 16,
            "batch_size": 8,
            "steps": 3,
            "data.val_fraction": 0.5,
        },
        "suite": str(folder / "suite.yaml"),
        "episodes": 2,
        "variants": VARIANTS,
        **changes,
    }
    path = folder / "compare.yaml"
    path.write_text(yaml.safe_dump(written, sort_keys=False))
    return load_config(CompareConfig, path)


@pytest.mark.slow
def test_every_variant_is_trained_and_evaluated_once(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = described(tmp_path)
    rows = compare(config, out, workers=0)
    assert [row["variant"] for row in rows] == list(VARIANTS)
    assert all(row["episodes"] == 2 and row["updates"] == 3 for row in rows)
    assert all(0 < row["latency_ms"]["p50"] <= row["latency_ms"]["p95"] for row in rows)
    assert rows[0]["parameters"] != rows[1]["parameters"], "each variant's own fields were set"
    assert (out / "plot.png").read_bytes()[:4] == b"\x89PNG"
    assert json.loads((out / "results.json").read_text())["rows"] == rows
    assert (out / "table.md").read_text() == table(rows)

    marked = out / "runs" / "plain-0" / "row.json"
    marked.write_text(json.dumps({**json.loads(marked.read_text()), "success_rate": 0.5}))
    again = compare(described(tmp_path, seeds=[0]), out, workers=0)
    assert again[0]["success_rate"] == 0.5, "what was finished is read, not done again"
    assert again[0]["ci95"] == list(wilson(1, 2))

    with pytest.raises(UsageError, match=r"another common.*variants\.plain"):
        compare(described(tmp_path, common={}, variants={"plain": {"batch_size": 4}}), out)


def test_a_mistake_is_found_before_anything_runs(tmp_path: Path) -> None:
    config = described(tmp_path, variants={"plain": {}, "odd": {"policy.head.tpye": "mog"}})
    with pytest.raises(UsageError, match=r"variant .odd.*tpye"):
        compare(config, tmp_path / "out", workers=0)
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError, match="nothing to compare"):
        compare(described(tmp_path, variants={}), tmp_path / "out")


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("x")
    with pytest.raises(UsageError, match="holds no comparison"):
        compare(described(tmp_path), tmp_path / "out", workers=0)


@pytest.mark.slow
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_variant_is_a_training(path: Path) -> None:
    config = load_config(CompareConfig, path)
    assert config.suite.is_file()
    assert all(config.training(variant, 0).steps > 0 for variant in config.variants)


def test_the_best_stands_first_in_the_table() -> None:
    row = {
        "by_seed": [0.5],
        "episodes": 10,
        "parameters": 1_000_000,
        "train_core_seconds": 10.0,
        "latency_ms": {"p50": 1.0, "p95": 2.0},
        "privileged": {"training": ["clean labels"], "relabeling": [], "goal": []},
    }
    rows = [
        {**row, "variant": name, "success_rate": rate, "ci95": list(wilson(round(10 * rate), 10))}
        for name, rate in (("worse", 0.2), ("better", 0.5))
    ]
    lines = table(rows).splitlines()
    assert lines[2].startswith("| better | **50 %** of 10 | 24 to 76 | 50 | training: clean labels | 1.00 M | 10 |")
    assert lines[3].startswith("| worse | **20 %** of 10 |")
    assert "| unknown |" in table([{**rows[0], "privileged": None}]), "a row from before there was a record"
