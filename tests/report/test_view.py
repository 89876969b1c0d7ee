"""What rerun is handed: read back from the file it writes."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rerun.experimental import RrdReader

from playlearn.episode import Array
from playlearn.errors import StoreError, UsageError
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.report.page import Shown, page
from playlearn.report.pictures import Pictures, encode_still
from playlearn.report.view import view_episode, view_results
from playlearn.store import NativeStore
from tests.synthetic import QUANTITIES, make_store


def logged(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Entity -> column -> values, in the order they were logged, of everything with a time."""
    found: dict[str, dict[str, list[Any]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            columns = found.setdefault(chunk.entity_path, {})
            for name, values in chunk.to_record_batch().to_pydict().items():
                columns.setdefault(name, []).extend(values)
    return found


def pictures(columns: Mapping[str, list[Any]], height: int, width: int) -> Array:
    """(n, h, w, 3) uint8."""
    return np.array([buffer[0] for buffer in columns["Image:buffer"] if buffer]).reshape(-1, height, width, 3)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    folder = tmp_path_factory.mktemp("view")
    return make_store(folder / "play", np.random.default_rng(0), 2, 160, {"front": (6, 8), "wrist": (5, 5)})


@pytest.fixture(scope="module")
def episode_file(store: NativeStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rrd") / "new" / "one.rrd"
    assert view_episode(store.path, 1, save=out) == out
    assert [path.name for path in out.parent.iterdir()] == ["one.rrd"]
    return out


def test_an_episode_is_there_step_by_step(store: NativeStore, episode_file: Path) -> None:
    found, episode = logged(episode_file), store.read(1)
    assert found["/camera/front"]["step"] == list(range(161))
    assert found["/action/executed"]["step"] == list(range(160))
    np.testing.assert_array_equal(pictures(found["/camera/front"], 6, 8), episode.images["front"])
    np.testing.assert_array_equal(pictures(found["/camera/wrist"], 5, 5), episode.images["wrist"])
    for path, values in (
        ("/state", episode.state),
        ("/action/executed", episode.action),
        ("/action/label", episode.expert_action),
        ("/achieved/red", episode.achieved[:, :5]),
        ("/achieved/lamp", episode.achieved[:, 6:]),
    ):
        np.testing.assert_array_equal(np.array(found[path]["Scalars:scalars"], np.float32), values)
    assert found["/state"]["time"][20].total_seconds() == 1.0  # step 20 at 20 Hz


def test_events_name_skills_and_settled_moments(store: NativeStore, episode_file: Path) -> None:
    events, episode = logged(episode_file)["/events"], store.read(1)
    events_at = dict(zip(events["step"], (text[0] for text in events["TextLog:text"]), strict=True))
    begins = [0, *(np.flatnonzero(np.diff(episode.skill)) + 1)]
    for t in begins:
        assert events_at[t] == episode.meta.skills[episode.skill[t]]
    moments, _ = RelabelIndex.build(
        [episode.achieved], episode.meta.achieved_names, 20.0, SettlingConfig(), QUANTITIES.achieved
    ).settled(0)
    assert len(moments) >= 1
    for moment in moments:
        assert events_at[moment].startswith("settled: ")
    assert events_at[160] == "ended: length"
    assert len(events_at) == len(begins) + len(moments) + 1


def test_beside_each_camera_is_the_goal_that_comes_next(store: NativeStore, episode_file: Path) -> None:
    found, episode = logged(episode_file), store.read(1)
    moments, _ = RelabelIndex.build(
        [episode.achieved], episode.meta.achieved_names, 20.0, SettlingConfig(), QUANTITIES.achieved
    ).settled(0)
    goals = found["/goal/front"]
    np.testing.assert_array_equal(pictures(goals, 6, 8), episode.images["front"][moments])
    # The first from the beginning, each other from where the one before it was reached; then none.
    assert goals["step"] == [0, *moments]


def test_no_images_are_no_mishap(tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 1, 20)
    out = view_episode(store.path, save=tmp_path / "one.rrd")
    assert out is not None
    assert not [path for path in logged(out) if path.startswith(("/camera", "/goal"))]


def test_without_a_display_a_file_is_written(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.chdir(tmp_path)
    assert view_episode(store.path) == Path("play-episode-0.rrd")
    assert (tmp_path / "play-episode-0.rrd").exists()
    assert "rerun play-episode-0.rrd" in capsys.readouterr().out


def test_what_cannot_be_shown_is_said(store: NativeStore, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no episode 2"):
        view_episode(store.path, 2, save=tmp_path / "one.rrd")
    with pytest.raises(UsageError, match=r"not an evaluation.*playlearn eval"):
        view_results(tmp_path, save=tmp_path / "one.rrd")
    assert list(tmp_path.iterdir()) == []


COLORS = {"start": (250, 10, 10), "goal": (10, 250, 10), "final": (10, 10, 250)}


@pytest.fixture
def evaluation(tmp_path: Path) -> Path:
    """Three episodes of a policy and one of a reference; pictures of episode 1 only."""
    rates = {"episodes": 3, "success_rate": 1 / 3, "ci95": [0.0, 1.0], "strict_rate": 0.0, "strict_ci95": [0.0, 1.0]}
    results = {
        **rates,
        "suite": "synthetic",
        "goal_modality": "image",
        "tasks": {"push": rates},
        "crashed": 0,
        "steps_to_success": 9.0,
        "references": {},
        "redraws": 0,
        "seed": 0,
        "renderer": "none",
        "versions": {},
        "git_revision": None,
        "policy": {"name": "policy"},
        "config": {"success_hold_steps": 1, "max_steps": 10, "kind": {"type": "tasks"}},
        "seconds": 1.0,
        "achieved_names": ["red.x", "red.y"],
    }
    stills = {name: encode_still(np.full((16, 16, 3), color, np.uint8)) for name, color in COLORS.items()}
    shown = [Shown(1, "push", success=True, reason="reached", steps=9, pictures=Pictures(**stills))]
    rows = [
        {
            "policy": policy,
            "episode": episode,
            "task": "push",
            "success": episode == 1,
            "steps": 9,
            "reason": "reached" if episode == 1 else "not reached in 9 steps",
            "start_achieved": [0.0, 0.0],
            "goal_achieved": [0.5, 0.25],
            "final_achieved": [0.375, 0.25],
        }
        for policy, episode in (("policy", 2), ("policy", 0), ("expert", 0), ("policy", 1))
    ]
    folder = tmp_path / "eval"
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps(results))
    (folder / "report.html").write_text(page(results, {"policy": [0.0, 1 / 3]}, 20.0, shown, ""))
    pq.write_table(pa.Table.from_pylist(rows), folder / "episodes.parquet")
    return folder


def test_an_evaluation_shows_the_goal_beside_what_was_achieved(evaluation: Path, tmp_path: Path) -> None:
    out = view_results(evaluation, save=tmp_path / "results.rrd")
    assert out is not None
    found = logged(out)
    assert found["/success"]["episode"] == [0, 1, 2]  # in order, the evaluated policy's alone
    assert found["/success"]["Scalars:scalars"] == [[0.0], [1.0], [0.0]]
    text = found["/outcome"]["TextDocument:text"][1][0]
    assert "# push, episode 1\nreached (9 steps)" in text
    assert "| red.x | 0.000 | 0.500 | 0.375 | -0.125 |" in text
    assert "| red.y | 0.000 | 0.250 | 0.250 | +0.000 |" in text
    for still, color in COLORS.items():
        columns = found[f"/pictures/{still}"]
        # WebP is lossy, and a plain square loses next to nothing.
        assert np.abs(pictures(columns, 16, 16).astype(int) - color).max() < 12
        assert sorted(columns["episode"]) == [0, 1, 2]  # episodes without a picture clear the one before


def test_an_evaluation_without_a_report_or_names_still_has_numbers(evaluation: Path, tmp_path: Path) -> None:
    (evaluation / "report.html").unlink()
    results = json.loads((evaluation / "results.json").read_text())
    del results["achieved_names"]
    (evaluation / "results.json").write_text(json.dumps(results))
    out = view_results(evaluation, save=tmp_path / "results.rrd")
    assert out is not None
    found = logged(out)
    assert "| 0 | 0.000 | 0.500 | 0.375 | -0.125 |" in found["/outcome"]["TextDocument:text"][0][0]
    assert "Image:buffer" not in found["/pictures/goal"]


def test_reruns_own_tool_finds_the_file_whole(episode_file: Path) -> None:
    tool = Path(sys.executable).with_name("rerun")
    done = subprocess.run(
        [tool, "rrd", "verify", episode_file],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        env={**os.environ, "TELEMETRY_ENABLED": "false"},
    )
    assert done.returncode == 0, done.stderr
