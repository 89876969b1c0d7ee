"""A disk that is full, fails, or loses its power: at whichever step of a commit."""

import errno
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import IO, Any, Self

import pytest

from playlearn import cli
from playlearn.collection import CollectConfig, collect
from playlearn.config import save_config
from playlearn.store import NativeStore
from tests.faults import point
from tests.faults.command import HERE, LIMIT, SCRIPT, contents, episodes


@pytest.mark.slow
@pytest.mark.skipif(
    not shutil.which("unshare")
    or subprocess.run(["unshare", "-Urm", "true"], capture_output=True, check=False).returncode != 0,
    reason="may not mount a disk of its own here",
)
def test_a_disk_that_fills_up(tmp_path: Path) -> None:
    """A real file system of 300 kB holds some of 12 episodes of 30 kB; made larger, it takes the others.

    Made read-only, it is not written to, and reported.
    """
    config = CollectConfig(environment=point.config().environment, episodes=12, steps=12, cameras=("front",), seed=5)
    save_config(config, tmp_path / "collect.yaml")
    collect(config, tmp_path / "whole", workers=0)
    disk = tmp_path / "disk"
    disk.mkdir()
    command = [
        sys.executable,
        str(SCRIPT),
        "collect",
        "--config",
        "collect.yaml",
        "--workers",
        "0",
        "--out",
        "disk/play",
    ]
    run = shlex.join(command)
    script = f"""
        mount -t tmpfs -o size=300k none disk
        {run}; echo code $?
        cp -r disk/play full
        mount -o remount,size=2m disk
        {run} --resume; echo code $?
        cp -r disk/play done
        mount -o remount,ro disk
        {run} --resume --episodes 13; echo code $?
    """
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", script],
        cwd=tmp_path,
        env={**os.environ, **HERE},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert re.findall(r"code (\d+)", done.stdout) == ["1", "0", "1"], done.stderr
    safe = episodes(tmp_path / "full")
    assert 3 <= safe <= 10
    assert f"the disk is full; {safe} episodes are safe" in done.stderr
    assert "Read-only file system" in done.stderr
    assert NativeStore.open(tmp_path / "full").verify() == []
    assert contents(tmp_path / "done") == contents(tmp_path / "whole")


class Broken:
    """A file that takes half of what is written to it."""

    def __init__(self, file: IO[bytes], number: int) -> None:
        self._file, self._number = file, number

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, data: bytes) -> None:
        self._file.write(data[: len(data) // 2])
        raise OSError(self._number, os.strerror(self._number))


@pytest.mark.slow
@pytest.mark.parametrize("where", ["open", "write", "fsync", "rename", "fsync of the folder"])
@pytest.mark.parametrize(("number", "message"), [(errno.ENOSPC, "the disk is full"), (errno.EIO, "cannot write")])
def test_the_disk_fails_at_any_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, number: int, message: str, capfd: Any, config: Path
) -> None:
    """The third of 12 episodes cannot be written: two are safe (three once it has its name), and --resume continues."""
    out = tmp_path / "play"
    arguments = ["collect", "--config", str(config), "--out", str(out), "--workers", "0"]
    with monkeypatch.context() as patch:
        fail(patch, where, number, "000002")
        assert cli.main(arguments) == 1
    safe = 3 if where == "fsync of the folder" else 2
    assert re.search(rf"{message}.*; {safe} episodes are safe.*--resume", capfd.readouterr().err)
    assert sorted(path.name for path in (out / "episodes").iterdir()) == [f"00000{i}.safetensors" for i in range(safe)]
    assert cli.main([*arguments, "--resume"]) == 0
    collect(point.config(), tmp_path / "whole", workers=0)
    assert contents(out) == contents(tmp_path / "whole")


def fail(patch: pytest.MonkeyPatch, where: str, number: int, name: str) -> None:
    """Let that step of writing the file `name` fail."""
    opened, fsync, replace = Path.open, os.fsync, Path.replace
    error = OSError(number, os.strerror(number))
    written: list[str] = []

    def failing_open(path: Path, mode: str = "r", *rest: Any, **options: Any) -> Any:
        if "w" not in mode:
            return opened(path, mode, *rest, **options)
        written.append(path.name)
        if name in path.name and where == "open":
            raise error
        file = opened(path, mode, *rest, **options)
        return Broken(file, number) if name in path.name and where == "write" else file

    def failing_fsync(descriptor: int) -> None:
        folder = Path(f"/proc/self/fd/{descriptor}").readlink().is_dir()
        if written and name in written[-1] and where == ("fsync of the folder" if folder else "fsync"):
            raise error
        fsync(descriptor)

    def failing_replace(path: Path, target: Path) -> Path:
        if name in path.name and where == "rename":
            raise error
        return replace(path, target)

    patch.setattr(Path, "open", failing_open)
    patch.setattr(os, "fsync", failing_fsync)
    patch.setattr(Path, "replace", failing_replace)


def test_bytes_are_on_the_disk_before_the_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a power cut asks for: fsync of the file, then rename, then fsync of the folder; so for every file."""
    order: list[tuple[str, str]] = []
    fsync, replace = os.fsync, Path.replace

    def noting_fsync(descriptor: int) -> None:
        order.append(("fsync", Path(f"/proc/self/fd/{descriptor}").readlink().name))
        fsync(descriptor)

    def noting_replace(path: Path, target: Path) -> Path:
        order.append(("rename", f"{path.name} {target.name}"))
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", noting_fsync)
    monkeypatch.setattr(Path, "replace", noting_replace)
    collect(point.config(episodes=2), tmp_path / "new" / "play", workers=0)
    assert order[:3] == [("fsync", "play"), ("fsync", "new"), ("fsync", tmp_path.name)], "the folders themselves"
    names = []
    for (sync, temporary), (rename, files), (sync_too, folder) in zip(*[iter(order[3:])] * 3, strict=True):
        assert (sync, rename, sync_too) == ("fsync", "rename", "fsync")
        assert files.split()[0] == temporary != files.split()[1]
        names.append((files.split()[1], folder))
    episode_names = [(f"00000{i}.safetensors", "episodes") for i in range(2)]
    assert names == [(name, "play") for name in ("collect.json", "collect.yaml", "store.json")] + episode_names
