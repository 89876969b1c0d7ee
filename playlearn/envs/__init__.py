"""The environments: a file (or a folder) each, with its scene, named tasks, success tests and skill library.

Importing one registers it: its config under `environment: {type: ...}`, and the skill library that acts in it.
"""

import playlearn.sim  # noqa: F401 - first: it picks MuJoCo's OpenGL, which is read when mujoco is first imported
from playlearn.envs.door import DoorConfig
from playlearn.envs.lift import LiftConfig
from playlearn.envs.make import make_env
from playlearn.envs.nut_assembly import NutAssemblyConfig
from playlearn.envs.ogbench import OgbenchCubeConfig, OgbenchPlayConfig, OgbenchSceneConfig
from playlearn.envs.pick_place import PickPlaceConfig
from playlearn.envs.playtable import PlayTableConfig
from playlearn.envs.stack import StackConfig
from playlearn.envs.wipe import WipeConfig

__all__ = [
    "DoorConfig",
    "LiftConfig",
    "NutAssemblyConfig",
    "OgbenchCubeConfig",
    "OgbenchPlayConfig",
    "OgbenchSceneConfig",
    "PickPlaceConfig",
    "PlayTableConfig",
    "StackConfig",
    "WipeConfig",
    "make_env",
]
