"""The folder of a native store: file names, the writer's lock, and what a kill leaves behind."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import filelock

from playlearn.config import RunFolder, atomic_write, sync_folder
from playlearn.errors import StoreError
from playlearn.store.tensors import TEMPORARY

SUFFIX = ".safetensors"


def episode_path(folder: Path, index: int) -> Path:
    """The file of the episode recorded under `index`."""
    return folder / "episodes" / f"{index:06d}{SUFFIX}"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the writer's lock; the kernel releases it when its holder dies."""
    lock = filelock.FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except filelock.Timeout as error:
        raise StoreError(
            f"{folder} is being written by another process: wait for it to end (lock: {lock.lock_file})"
        ) from error
    try:
        yield
    finally:
        lock.release()


def check_free(folder: Path, notes: Collection[str]) -> None:
    """Raises StoreError if the folder already holds something."""
    if (folder / "store.json").exists():
        raise StoreError(f"{folder} is already a store: add to it with --resume, or name another folder")
    allowed = {".lock", "episodes", *notes}  # left by a kill while a store is made
    if folder.exists() and (not folder.is_dir() or any(path.name not in allowed for path in _entries(folder))):
        raise StoreError(f"{folder} already holds something that is not a store: name another folder")
    if _entries(folder / "episodes"):
        raise StoreError(f"{folder} holds episodes but no store.json: put it back, or name another folder")


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, durably: they survive a power cut."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for path in made:
        sync_folder(path.parent)


def claim(folder: Path, name: str, note: Mapping[str, Any], what: str) -> None:
    """Record in the file `name` what the folder's files are made with, and prepare the folder.

    note: everything that determines the files, as JSON.
    what: what the files are, for messages.

    Raises:
        UsageError: the files there were made with something else.
    """
    claimed = RunFolder(folder, name, what, f"name another {what}.folder", leftovers=("episodes",))
    if claimed.begun():
        sweep(folder)
        claimed.check_same(json.loads(claimed.file.read_text()), note)
        return
    make_folder(folder / "episodes")
    atomic_write(claimed.file, json.dumps(note, indent=2).encode())


def sweep(folder: Path) -> None:
    """Remove files that killed writers left half written."""
    for place in (folder, folder / "episodes"):
        for leftover in place.glob(f".*{TEMPORARY}"):
            leftover.unlink(missing_ok=True)


def indices(folder: Path) -> list[int]:
    """The numbers of the episodes that are there, in any order."""
    numbers = (_index_of(path) for path in (folder / "episodes").glob(f"*{SUFFIX}"))
    return [number for number in numbers if number is not None]


def foreign_files(folder: Path) -> list[Path]:
    """Files among the episodes that are not episodes."""
    return sorted(path for path in _entries(folder / "episodes") if _index_of(path) is None)


def _entries(folder: Path) -> list[Path]:
    """The entries of a folder, without files that are still being written."""
    return [path for path in folder.iterdir() if path.suffix != TEMPORARY] if folder.is_dir() else []


def _index_of(path: Path) -> int | None:
    """The number in the name of an episode file; None for any other file."""
    stem = path.name.removesuffix(SUFFIX)
    number = int(stem) if stem.isascii() and stem.isdecimal() else None
    return number if number is not None and path.name == episode_path(path, number).name else None
