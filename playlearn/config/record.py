"""What a run records of itself, and how: whole files, package versions, the commit."""

import functools
import os
import platform
import subprocess
import threading
from importlib import metadata
from pathlib import Path

from playlearn import __version__

RECORDED = ("torch", "numpy", "mujoco", "robosuite", "ogbench", "lerobot", "diffusers", "transformers")


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, and survives a power cut once this returns."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


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
