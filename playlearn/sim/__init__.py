"""Simulation: scenes behind one Environment contract, fast stepping and rendering."""

import logging
import os
import sys

# MuJoCo picks its OpenGL when it is first imported, and robosuite remarks on optional parts of itself.
if sys.platform == "linux":
    os.environ.setdefault("MUJOCO_GL", "egl")
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)

from playlearn.sim.environment import CameraConfig, Environment, EnvironmentConfig, EnvironmentSpec, Task  # noqa: E402

__all__ = ["CameraConfig", "Environment", "EnvironmentConfig", "EnvironmentSpec", "Task"]
