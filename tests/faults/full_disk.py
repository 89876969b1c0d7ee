"""Every writer on a disk that fills up: `python full_disk.py ROOMY_FOLDER SMALL_DISK [WRITER ...]`, in one process.

A filler leaves a writer so many pages, more from try to try, until it comes through. Each failure must be a DiskError
that names a folder on that disk, and must leave every file that was whole as it was and nothing unfinished. Prints
one JSON line: writer -> how many tries failed. The writers are in `writers.py`.
"""

import contextlib
import io
import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from playlearn.errors import PlaylearnError
from tests.faults.writers import writers

PAGE = 4096
TEMPORARY = (".tmp", ".building", ".lock")


@dataclass
class Disk:
    """A small disk."""

    folder: Path

    def fill(self, pages: int) -> None:
        """Leave so many pages free."""
        with (self.folder / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(PAGE))
        size = (self.folder / "filler").stat().st_size
        os.truncate(self.folder / "filler", max(0, size - pages * PAGE))

    def files(self) -> dict[str, bytes]:
        """The content of each, but for the filler."""
        paths = [path for path in self.folder.rglob("*") if path.is_file() and path.name != "filler"]
        return {str(path.relative_to(self.folder)): path.read_bytes() for path in paths}


def sweep(disk: Disk, act: Callable[[], Any], growing: tuple[str, ...]) -> int:
    """Let it run with more and more room until it comes through; how often it failed.

    growing: names of files that may be longer after a failure.
    """
    pages, failed = 0, 0
    while True:
        before = disk.files()
        disk.fill(pages)
        try:
            act()
        except PlaylearnError as error:  # a comparison counts the runs that failed, and says why each did
            message = str(error)
        else:
            return failed
        assert f"{disk.folder}" in message, message
        assert "the disk is full" in message, message
        assert pages * PAGE < shutil.disk_usage(disk.folder).total, "too small a disk for it"
        failed, pages = failed + 1, 8 * pages + 1
        after = disk.files()
        left = [name for name in disk.folder.rglob("*") if name.name.endswith(TEMPORARY)]
        assert left == [], f"{left} with {pages} pages"
        for name, content in before.items():
            if not name.endswith(growing):
                assert name not in after or after[name] == content or _whole(disk.folder / name), name


def _whole(path: Path) -> bool:
    """Whether a file that was replaced is whole: those of a job that was run again may differ."""
    if path.suffix == ".json":
        json.loads(path.read_text())
    return path.stat().st_size > 0


def main(roomy: Path, small: Path, only: list[str]) -> dict[str, int]:
    torch.set_num_threads(1)
    disk, failures = Disk(small), {}
    for name, act in writers(roomy, small):
        if only and name not in only:
            continue
        print(f"== {name}", file=sys.stderr, flush=True)
        failures[name] = sweep(disk, act, ("metrics.jsonl", ".log"))
        if name != "eval":
            for path in small.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    return failures


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):
        found = main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    print(json.dumps(found))
