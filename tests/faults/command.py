"""The command with the fake environment, as a process of its own; and what is left of it afterwards."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from tests.faults import point

SCRIPT = Path(point.__file__)
MARK = "PLAYLEARN_TEST"
LIMIT = 1800.0  # seconds; what takes some of them ends far below on any machine, and only what hangs runs into it
HERE = {"PYTHONPATH": str(SCRIPT.parents[2]), "OMP_NUM_THREADS": "1"}


def start(
    *arguments: object, faults: Mapping[int, str] | None = None, pace: float = 0.0, retries: int = 2, mark: str = ""
) -> "subprocess.Popen[str]":
    """`playlearn ...`; faults, pace, retries: see `tests/faults/point.py`; mark: see `gone`."""
    how = {point.PACE: str(pace), point.FAULTS: json.dumps(faults or {}), point.RETRIES: str(retries), MARK: mark}
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *map(str, arguments)],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **HERE, **how},
        start_new_session=True,
    )


def finish(process: "subprocess.Popen[str]") -> tuple[int, str]:
    """Exit code and what it printed."""
    _, errors = process.communicate(timeout=LIMIT)
    return process.returncode, errors


def gone(mark: str, seconds: float = 120.0) -> bool:
    """Whether every process of that run is over, or is so within a moment (of a busy machine)."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if not any(f"{MARK}={mark}".encode() in _environ(folder) for folder in Path("/proc").glob("[0-9]*")):
            return True
        time.sleep(0.05)
    return False


def episodes(out: Path) -> int:
    """How many can be seen there."""
    return len(list((out / "episodes").glob("*.safetensors")))


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of every episode, and what they were made from."""
    return {path.name: path.read_bytes() for path in [*folder.glob("episodes/*"), folder / "collect.json"]}


def _environ(folder: Path) -> bytes:
    try:
        return (folder / "environ").read_bytes()
    except OSError:
        return b""
