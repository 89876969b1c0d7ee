"""Every writer on a real disk that fills up: told as that, nothing half done is left, and then it comes through."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.command import HERE, LIMIT

SCRIPT = Path(__file__).with_name("full_disk.py")
# The quick ones of different libraries; all are tried where none is named.
WRITERS = (
    "train",
    "diagnose",
    "demo",
    "render",
    "export robomimic",
    "info --report .png",
    "view --save .rrd",
    "config",
)


@pytest.mark.slow
@pytest.mark.skipif(
    not shutil.which("unshare")
    or subprocess.run(["unshare", "-Urm", "true"], capture_output=True, check=False).returncode != 0,
    reason="may not mount a disk of its own here",
)
def test_every_writer(tmp_path: Path) -> None:
    """64 MB, more of which is free from try to try; see `full_disk.py`. Each failed at least once."""
    for name in ("roomy", "disk"):
        (tmp_path / name).mkdir()
    script = f'mount -t tmpfs -o size=64m none disk && exec "{sys.executable}" "{SCRIPT}" roomy disk "$@"'
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", script, "sh", *WRITERS],
        cwd=tmp_path,
        env={**os.environ, **HERE, "HF_DATASETS_CACHE": str(tmp_path / "roomy" / "cache")},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    failures = json.loads(done.stdout)
    assert failures.keys() == {*WRITERS}
    assert all(failures.values()), failures
