import subprocess
import sys

import pytest


@pytest.mark.slow
def test_training_imports_no_simulator() -> None:
    """Training reads stores: whoever only trains should not wait for a simulator, nor need one installed."""
    code = "import sys, playlearn.training; print(sorted({'mujoco', 'ogbench', 'robosuite'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
