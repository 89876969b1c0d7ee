"""An episode that fails loses no other, is reported with its number and seed, and can be played again by itself."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from playlearn import cli
from playlearn.collection import collect, episode_seed
from playlearn.store import NativeStore
from tests.faults import point
from tests.faults.command import contents, finish, start

FAULTS = {1: "killed", 3: "bug", 5: "hangs", 6: "diverges at once", 8: "diverges"}
WHY = {
    1: "was killed by SIGKILL",
    3: "ZeroDivisionError: a bug",
    5: "did not finish within 8 s",
    6: "ended before its first action: diverged: the point left the plane",
}


@pytest.mark.slow
def test_what_fails_loses_nothing_else_and_is_told(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of 12 episodes four fail, each in its own way; a fifth diverges on the way and is kept as far as it went."""
    out = tmp_path / "play"
    arguments = ("collect", "--config", config, "--out", out, "--workers", 2, "--timeout", 8)
    code, errors = finish(start(*arguments, faults=FAULTS, retries=0))
    assert code == 1
    store = NativeStore.open(out)
    assert store.indices().tolist() == [0, 2, 4, 7, 8, 9, 10, 11]
    assert store.verify() == []
    assert list((out / "episodes").glob(".*")) == []
    assert store.meta(4).ended == "diverged: the point left the plane"
    assert store.lengths().tolist() == [12, 12, 12, 12, point.AT - 1, 12, 12, 12]
    assert "4 episodes failed" in errors
    commands = dict(re.findall(r"by itself, with a traceback: (playlearn collect .*--episode (\d+))", errors))
    listed = {int(index): command for command, index in commands.items()}
    assert listed.keys() == WHY.keys()
    for index, why in WHY.items():
        assert re.search(rf"episode {index} \(seed {episode_seed(point.SEED, index)}\): .*{re.escape(why)}", errors)

    # The command, as it was printed: the bug shows itself with a traceback, and nothing is changed.
    before = contents(out)
    monkeypatch.setenv(point.FAULTS, json.dumps(FAULTS))
    with pytest.raises(ZeroDivisionError):
        cli.main(shlex.split(listed[3])[1:])
    assert cli.main(shlex.split(listed[6])[1:]) == 1
    assert "Traceback" in capfd.readouterr().err
    assert contents(out) == before

    # Once nothing happens any more, the same command adds the episode, and --resume the others.
    monkeypatch.delenv(point.FAULTS)
    assert cli.main(shlex.split(listed[3])[1:]) == 0
    assert len(NativeStore.open(out)) == 9
    collect(point.config(), out, workers=0, resume=True)
    monkeypatch.setenv(point.FAULTS, json.dumps({8: "diverges"}))
    collect(point.config(), tmp_path / "whole", workers=0)
    assert contents(out) == contents(tmp_path / "whole")


@pytest.mark.slow
def test_a_hang_alone_says_where_and_ends(tmp_path: Path, config: Path) -> None:
    arguments = ("collect", "--config", config, "--out", tmp_path / "play", "--episode", 5, "--timeout", 5)
    code, errors = finish(start(*arguments, faults=FAULTS))
    assert code == 1
    assert "in _happen" in errors, "the stack of the place where it hangs"
    assert len(NativeStore.open(tmp_path / "play")) == 0
    with NativeStore.open(tmp_path / "play").writer():
        pass  # its lock is free


def test_what_befalls_every_episode_ends_the_job_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], config: Path
) -> None:
    """A bug in all of 40 episodes is not tried 40 times."""
    monkeypatch.setenv(point.FAULTS, json.dumps(dict.fromkeys(range(40), "bug")))
    arguments = ["collect", "--config", str(config), "--out", str(tmp_path / "play"), "--workers", "0"]
    assert cli.main([*arguments, "--episodes", "40"]) == 1
    errors = capfd.readouterr().err
    assert "10 episodes failed in a row: given up; 30 others were not tried" in errors


def test_an_episode_alone(tmp_path: Path, config: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """In a fresh folder a store of its own; in a store that has it, a comparison; never an overwriting."""
    collect(point.config(), tmp_path / "play", workers=0)
    arguments = ["collect", "--config", str(config), "--episode", "7", "--out"]
    assert cli.main([*arguments, str(tmp_path / "single")]) == 0
    single = NativeStore.open(tmp_path / "single")
    assert single.indices().tolist() == [7]
    name = "episodes/000007.safetensors"
    assert (tmp_path / "single" / name).read_bytes() == (tmp_path / "play" / name).read_bytes()
    assert cli.main([*arguments, str(tmp_path / "play")]) == 0
    assert "is the same, bit for bit" in capfd.readouterr().err
    shutil.copy(tmp_path / "play/episodes/000006.safetensors", tmp_path / "play" / name)
    before = contents(tmp_path / "play")
    assert cli.main([*arguments, str(tmp_path / "play")]) == 1
    assert re.search(r"it is not the one in .*achieved.*meta\.seed differ", capfd.readouterr().err)
    assert contents(tmp_path / "play") == before
