"""The worlds one can play in: a file (or a folder) each, with its scene, named tasks, judges, skills and driver.

To import one is to register it: its config under `environment: {type: ...}`, and who drives it.
"""

from playlearn.tasks.door import DoorConfig
from playlearn.tasks.lift import LiftConfig
from playlearn.tasks.nut_assembly import NutAssemblyConfig
from playlearn.tasks.ogbench import OgbenchCubeConfig, OgbenchPlayConfig, OgbenchSceneConfig
from playlearn.tasks.pick_place import PickPlaceConfig
from playlearn.tasks.playtable import PlayTableConfig
from playlearn.tasks.stack import StackConfig
from playlearn.tasks.wipe import WipeConfig

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
]
