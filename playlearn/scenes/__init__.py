"""Images that a simulator draws of many scenes, with what is true of them: what an image encoder learns from.

What it knows there is privileged: where everything is, and where in the picture each camera sees it.
"""

from playlearn.scenes.config import ScenesConfig
from playlearn.scenes.dataset import Scenes
from playlearn.scenes.draw import SceneEnvironment, draw_scenes, scene_sizes

__all__ = ["SceneEnvironment", "Scenes", "ScenesConfig", "draw_scenes", "scene_sizes"]
