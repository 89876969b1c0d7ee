"""A full disk is told as that, whichever library met it; files that belong together are replaced together."""

import errno
import os
from pathlib import Path
from typing import Any, Self

import pytest
from safetensors import SafetensorError

from playlearn.config import append_line, atomic_write_all, disk_errors, disk_problem
from playlearn.errors import DiskError, StoreError

FULL = "No space left on device"


def caused(cause: Exception) -> Exception:
    error = RuntimeError("Encoder thread failed")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, FULL),
        OSError(errno.EDQUOT, os.strerror(errno.EDQUOT)),
        OSError(f"Error writing bytes to file. Detail: [errno 28] {FULL}"),  # pyarrow
        SafetensorError(f'Error while serializing: I/O error: Os {{ code: 28, message: "{FULL}" }}'),
        RuntimeError(f"Encoder thread for front crashed: [Errno 28] {FULL}"),  # LeRobot, of PyAV's error
        caused(OSError(errno.ENOSPC, FULL)),
    ],
)
def test_every_library_s_full_disk_names_the_folder(tmp_path: Path, error: Exception) -> None:
    assert disk_problem(error) == "the disk is full"
    with pytest.raises(DiskError, match=f"{tmp_path}: the disk is full"), disk_errors(tmp_path):
        raise error


def test_other_errors_stay_themselves(tmp_path: Path) -> None:
    for error in (ValueError("no"), StoreError("broken"), OSError(errno.EIO, "Input/output error")):
        with pytest.raises(type(error), match=str(error.args[-1])), disk_errors(tmp_path):
            raise error
    with pytest.raises(DiskError, match=r"cannot write \(Input/output error\)"), disk_errors(tmp_path, every=True):
        raise OSError(errno.EIO, "Input/output error")


def test_the_folder_is_that_of_the_file_that_did_not_fit(tmp_path: Path) -> None:
    """A cache lies on another disk than the output."""
    with pytest.raises(DiskError, match=r"^/cache/frames: the disk is full"), disk_errors(tmp_path):
        raise OSError(errno.ENOSPC, FULL, "/cache/frames/000001.png")


def test_files_that_belong_together_are_replaced_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names, fsync, synced = ("results.json", "report.html", "episodes.parquet"), os.fsync, [0]
    atomic_write_all({tmp_path / name: b"old" for name in names})

    def third(descriptor: int) -> None:
        synced[0] += 1
        if synced[0] == len(names):
            raise OSError(errno.ENOSPC, FULL)
        fsync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", third)
        with pytest.raises(DiskError, match="the disk is full"):
            atomic_write_all({tmp_path / name: b"new" for name in names})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == dict.fromkeys(names, b"old")


class Half:
    """A file that takes half of what is written, then no more."""

    def __init__(self, file: Any) -> None:
        self._file, self._full = file, False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, data: bytes) -> int:
        if self._full:
            raise OSError(errno.ENOSPC, FULL)
        self._full = True
        written: int = self._file.write(data[: len(data) // 2])
        return written


def test_a_line_is_added_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = tmp_path / "metrics.jsonl", Path.open
    append_line(path, '{"step": 1}')
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", lambda file, *given, **options: Half(opened(file, *given, **options)))
        with pytest.raises(DiskError, match=f"{tmp_path}: the disk is full"):
            append_line(path, '{"step": 2}')
    append_line(path, '{"step": 3}')
    assert path.read_text() == '{"step": 1}\n{"step": 3}\n'
