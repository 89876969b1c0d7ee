"""However a command is interrupted: what was committed stays, no process is left, and it can be resumed."""

import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import numpy as np
import pytest

from playlearn import cli
from playlearn.collection import CollectConfig, collect
from playlearn.config import held, save_config
from playlearn.errors import BusyError
from playlearn.store import NativeStore, StoreSpec
from tests.faults import point
from tests.faults.command import HERE, contents, episodes, finish, gone, start
from tests.synthetic import make_episode


@pytest.mark.slow
def test_interrupted_in_every_way_and_resumed_by_any_number_of_workers(tmp_path: Path) -> None:
    """SIGKILL of the parent, Ctrl-C to the group, SIGTERM, with 2, 3 and 1 workers, then to the end with none.

    Every file then is that of an unbroken run on this machine, bit for bit; no process outlives an interruption, and
    no lock does.
    """
    config, out = point.config(episodes=120), tmp_path / "play"
    save_config(config, tmp_path / "collect.yaml")
    collect(config, tmp_path / "whole", workers=0)
    rng = np.random.default_rng(0)
    seen = 0
    for workers, how, code in ((2, signal.SIGKILL, -9), (3, signal.SIGINT, 130), (1, signal.SIGTERM, 130)):
        mark = uuid.uuid4().hex
        arguments = ("collect", "--config", tmp_path / "collect.yaml", "--out", out, "--workers", workers, "--resume")
        process = start(*arguments, pace=0.01, mark=mark)
        while episodes(out) == seen and process.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
        if how == signal.SIGINT:
            os.killpg(process.pid, how)  # as a terminal does
        else:
            process.send_signal(how)
        returned, errors = finish(process)
        assert returned == code
        assert gone(mark)
        assert "Traceback" not in errors
        assert code < 0 or "--resume" in errors
        assert seen < episodes(out) < 120
        seen = episodes(out)
        assert NativeStore.open(out).verify() == []
    collect(config, out, workers=0, resume=True)
    assert contents(out) == contents(tmp_path / "whole")


@pytest.mark.slow
def test_the_real_command_killed_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PlayTable and its physics: what a worker had done when its parent was killed, another process continues."""
    monkeypatch.undo()
    config, out = CollectConfig(episodes=4, steps=12), tmp_path / "play"
    save_config(config, tmp_path / "collect.yaml")
    command = ["-m", "playlearn.cli", "collect", "--config", str(tmp_path / "collect.yaml"), "--out", str(out)]
    process = subprocess.Popen([sys.executable, *command, "--workers", "1"], env={**os.environ, **HERE})
    while episodes(out) == 0 and process.poll() is None:
        time.sleep(0.002)
    process.kill()
    process.wait()
    assert episodes(out) >= 1
    collect(config, out, workers=0, resume=True)
    collect(config, tmp_path / "whole", workers=0)
    assert contents(out) == contents(tmp_path / "whole")


def test_a_clock_that_goes_backwards_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    collect(point.config(episodes=3), tmp_path / "whole", workers=0)
    now = iter(range(10**9, 0, -1000))
    monkeypatch.setattr(time, "time", lambda: float(next(now)))
    collect(point.config(episodes=1), tmp_path / "play", workers=0)
    collect(point.config(episodes=3), tmp_path / "play", workers=0, resume=True)
    assert contents(tmp_path / "play") == contents(tmp_path / "whole")


def test_a_second_collection_is_refused(tmp_path: Path, config: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "play"
    collect(point.config(episodes=2), out, workers=0)
    before = contents(out)
    arguments = ["collect", "--config", str(config), "--out", str(out), "--workers", "0"]
    with NativeStore.open(out).writer():
        for more in (["--resume"], ["--episode", "1"], ["--episode", "9"]):
            assert cli.main([*arguments, *more]) == 1
            assert "is being written by another process" in capfd.readouterr().err
    assert contents(out) == before
    assert cli.main([*arguments, "--resume"]) == 0


def test_two_that_begin_at_once_do_not_mix(tmp_path: Path) -> None:
    """While one process makes the store, no other writes into it."""
    (tmp_path / "play").mkdir()
    spec = StoreSpec.of(make_episode(np.random.default_rng(0), 3))
    with held(tmp_path / "play"), pytest.raises(BusyError, match="being written by another process"):
        NativeStore.create(tmp_path / "play", spec, {"note": lambda path: path.touch()})
    assert sorted(path.name for path in (tmp_path / "play").iterdir()) == ["episodes"]
    assert len(NativeStore.create(tmp_path / "play", spec)) == 0
