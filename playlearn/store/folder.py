"""The folder of a native store: file names, and what a kill leaves behind."""

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from playlearn.config import RunFolder, atomic_write, make_folder
from playlearn.config.held import LOCK
from playlearn.errors import StoreError
from playlearn.store.tensors import TEMPORARY

SUFFIX = ".safetensors"


def episode_path(folder: Path, index: int) -> Path:
    """The file of the episode recorded under `index`."""
    return folder / "episodes" / f"{index:06d}{SUFFIX}"


def check_free(folder: Path, notes: Collection[str]) -> None:
    """Raises StoreError if the folder already holds something."""
    if (folder / "store.json").exists():
        raise StoreError(f"{folder} is already a store: add to it with --resume, or name another folder")
    allowed = {LOCK, "episodes", *notes}  # left by a kill while a store is made
    if folder.exists() and (not folder.is_dir() or any(path.name not in allowed for path in _entries(folder))):
        raise StoreError(f"{folder} already holds something that is not a store: name another folder")
    if _entries(folder / "episodes"):
        raise StoreError(f"{folder} holds episodes but no store.json: put it back, or name another folder")


def claim(folder: Path, name: str, note: Mapping[str, Any], what: str) -> None:
    """Record in the file `name` what the folder's files are made with, and prepare the folder; the caller holds it.

    note: everything that determines the files, as JSON; `episodes` in it says of which each is made, by digest, and
        may grow.
    what: what the files are, for messages.

    Raises:
        UsageError: the files there were made with something else.
    """
    make_folder(folder / "episodes")
    sweep(folder)
    before = claimed(folder, name, note, what)
    episodes = {**before.get("episodes", {}), **note.get("episodes", {})}
    atomic_write(folder / name, json.dumps({**note, "episodes": episodes}, indent=2).encode())


def claimed(folder: Path, name: str, note: Mapping[str, Any], what: str) -> Mapping[str, Any]:
    """What `claim` recorded there, empty where it did not; raises UsageError as it does. Changes nothing."""
    own = RunFolder(folder, name, what, f"name another {what}.folder", entries=("episodes",), leftovers=("episodes",))
    if not own.begun():
        return {}
    before: dict[str, Any] = json.loads(own.file.read_text(encoding="utf-8"))
    own.check_same(before, note)
    return before


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
