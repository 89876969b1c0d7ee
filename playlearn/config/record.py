"""What a run records of itself, and how: whole files, package versions, the commit."""

import functools
import os
import platform
import subprocess
import threading
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

from playlearn import __version__
from playlearn.config.disk import disk_errors

RECORDED = ("torch", "numpy", "mujoco", "robosuite", "ogbench", "lerobot", "diffusers", "transformers")


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, and survives a power cut once this returns.

    Raises:
        DiskError: it cannot be written; the file of that name is as it was.
    """
    atomic_write_all({path: data})


def atomic_write_all(files: Mapping[Path, bytes]) -> None:
    """Write files of one folder that belong together: none is replaced before all of them are on the disk.

    Raises:
        DiskError: one of them cannot be written; all are as they were.
    """
    folder = next(iter(files)).parent
    unfinished = {path: path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp") for path in files}
    with disk_errors(folder, every=True):
        try:
            for path, data in files.items():
                with unfinished[path].open("wb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
            for path, temporary in unfinished.items():
                temporary.replace(path)
            sync_folder(folder)
        except BaseException:
            for temporary in unfinished.values():
                temporary.unlink(missing_ok=True)
            raise


def append_line(path: Path, line: str) -> None:
    """Add a line to a file, whole or not at all.

    Raises:
        DiskError: it cannot be written; the file is as it was.
    """
    before, left = path.stat().st_size if path.exists() else 0, f"{line}\n".encode()
    with disk_errors(path.parent, every=True), path.open("ab", buffering=0) as file:
        try:
            while left:
                left = left[file.write(left) :]
        except OSError:
            os.truncate(path, before)
            raise


def make_folder(folder: Path) -> list[Path]:
    """Make a folder and its parents, durably: they survive a power cut. Returns those that were made, deepest first.

    Raises:
        DiskError: the disk is full, or the folder cannot be made there.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    with disk_errors(folder, every=True):
        folder.mkdir(parents=True, exist_ok=True)
        for path in made:
            sync_folder(path.parent)
    return made


def sync_folder(folder: Path) -> None:
    """Let what was made, renamed or removed in a folder survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def versions() -> dict[str, str]:
    """Package -> version of what can change a result; a package that is not installed is left out."""
    return dict(_installed())


@functools.cache
def _installed() -> tuple[tuple[str, str], ...]:
    # Looked up once: it takes 15 ms, and every episode records it.
    found = {"playlearn": __version__, "python": platform.python_version()}
    for package in RECORDED:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return tuple(found.items())


def git_revision() -> str | None:
    """The commit that this code was run from, `-dirty` where files differ from it; None outside a checkout."""
    folder = Path(__file__).resolve().parents[2]
    if not (folder / ".git").exists():
        return None
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        return f"{commit}-dirty" if _git(folder, "status", "--porcelain", "--untracked-files=no") else commit
    except (OSError, subprocess.SubprocessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()
