"""What is printed into a file is there whole or not at all."""

import errno
import io
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from playlearn.cli.output import whole_output
from playlearn.errors import DiskError


class Full(io.FileIO):
    """A file on a disk that has room for 1000 bytes more."""

    def __init__(self, path: Path, mode: str) -> None:
        super().__init__(path, mode)
        self._room = 1000

    def write(self, data: Any) -> int:
        if not stat.S_ISREG(os.fstat(self.fileno()).st_mode):  # led elsewhere
            return super().write(data)
        if not self._room:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = super().write(bytes(data)[: self._room])
        self._room -= written
        return written


def full(_descriptor: int, _data: bytes) -> int:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("before", ["", "what was there"])
def test_half_a_config_is_not_left(tmp_path: Path, before: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(before)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BufferedWriter(Full(path, "a"))))
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(DiskError, match=r"my\.yaml: the disk is full"), whole_output():
        print("store: datasets/play\n" * 1000)
    sys.stdout.close()
    assert path.read_text() == before


def test_other_errors_are_no_matter_of_the_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "my.yaml"
    monkeypatch.setattr(sys, "stdout", path.open("w"))
    with pytest.raises(ZeroDivisionError), whole_output():
        print(1 // len(print("printed") or ""))
    sys.stdout.close()
    assert path.read_text() == "printed\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("argument", ["doctor", "--help"])
def test_the_command_says_so_once(argument: str) -> None:
    """Python flushes standard output once more when it ends, and would complain a second time."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-m", "playlearn.cli", argument]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    assert done.returncode == 1
    assert done.stderr == "playlearn: /dev/full: the disk is full. Make room, and run the same command again\n"
