"""One writer a folder; an output that is built beside its place appears whole or not at all."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from playlearn.config import built_beside, held
from playlearn.errors import BusyError, DiskError, UsageError


def test_a_folder_is_held_by_one(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "a"
    with held(folder):
        (folder / "file").touch()
        with pytest.raises(BusyError, match=r"runs/a is being written by another process: wait.*\.lock"), held(folder):
            pass
        assert sorted(path.name for path in folder.iterdir()) == [".lock", "file"]
    assert [path.name for path in folder.iterdir()] == ["file"], "the lock goes with its holder"
    with held(folder):
        pass
    assert folder.is_dir(), "it was there before"


def test_a_folder_that_stays_empty_is_not_left(tmp_path: Path) -> None:
    def refused() -> None:
        with held(tmp_path / "runs" / "a"):
            raise UsageError("no such store")

    with pytest.raises(UsageError):
        refused()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is no folder"), held(tmp_path / "file"):
        pass


def test_a_killed_holder_holds_nothing(tmp_path: Path) -> None:
    """Its lock file stays and is taken over."""
    code = "import os,sys; from pathlib import Path; from playlearn.config import held\n"
    code += f"with held(Path({str(tmp_path)!r})): os.kill(os.getpid(), 9)"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == -9
    assert (tmp_path / ".lock").exists()
    with held(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_its_holder_removed_is_not_taken_for_the_present_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Opened before its holder went, locked after: a third process could hold a new file of that name."""
    import fcntl

    flock, opened = fcntl.flock, []

    def late(descriptor: int, how: int) -> None:
        opened.append(descriptor)
        if len(opened) == 1:
            (tmp_path / ".lock").unlink()
        flock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with held(tmp_path):
        assert len(opened) == 2
        assert os.path.samestat(os.fstat(opened[1]), (tmp_path / ".lock").stat())


def build(out: Path, *, failing: bool = False) -> None:
    with built_beside(out) as place:
        place.mkdir()
        (place / "file").write_text("whole")
        if failing:
            raise OSError(28, "No space left on device")


def test_an_output_appears_whole(tmp_path: Path) -> None:
    build(tmp_path / "new" / "out")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["out"]
    assert [path.name for path in (tmp_path / "new" / "out").iterdir()] == ["file"]


def test_an_output_that_failed_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(DiskError, match=r"the disk is full; nothing was left at .*new/out"):
        build(tmp_path / "new" / "out", failing=True)
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_builder_left_goes_and_a_living_one_is_left_alone(tmp_path: Path) -> None:
    place = tmp_path / ".out.building"
    (place / "out" / "half").mkdir(parents=True)
    with held(place), pytest.raises(BusyError, match="is being written by another process"):
        build(tmp_path / "out")
    assert (place / "out" / "half").is_dir()
    build(tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["file"]
    assert not place.exists()
