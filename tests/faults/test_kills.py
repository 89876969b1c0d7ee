"""SIGKILL at every step: what was committed loads and verifies, nothing half done is seen, and it can be resumed."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.faults.command import HERE, LIMIT

SCRIPT = Path(__file__).with_name("kills.py")


def scenario(name: str, folder: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), name, str(folder)],
        env={**os.environ, **HERE},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.slow
def test_killed_before_every_line_of_a_commit(tmp_path: Path) -> None:
    """Of some 135 moments only the last few, after the rename, leave an episode; the others leave none of it."""
    result = scenario("every_line_of_a_commit", tmp_path)
    assert result["kills"] > 100
    assert {"record.py", "tensors.py", "native.py"} <= {where.split(":")[0] for where in result["points"]}
    # Fsync of the folder: entering it, opening, syncing and closing come after the rename.
    assert 3 <= result["committed"] <= 10


def test_killed_half_written(tmp_path: Path) -> None:
    """The kernel ends the process after exactly so many bytes; they lie there under another name and are swept."""
    result = scenario("half_written", tmp_path)
    assert result["left"] == result["sizes"]


@pytest.mark.slow
def test_killed_before_every_line_of_a_collection(tmp_path: Path) -> None:
    """From the empty folder to the last episode; resumed, every file is that of an unbroken run here, bit for bit."""
    assert scenario("every_line_of_a_collection", tmp_path)["kills"] > 80


@pytest.mark.slow
def test_killed_at_random_moments(tmp_path: Path) -> None:
    """80 episodes, killed every ten or so at the latest, come out the same, and none is lost on the way."""
    assert scenario("random_moments", tmp_path)["kills"] >= 3
