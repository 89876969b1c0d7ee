"""Images that a simulator renders of many scenes, with the true state: what an image encoder learns from.

The true state is privileged information: where each object is, and where in the image each camera sees it.
"""

from playlearn.scenes.config import ScenesConfig
from playlearn.scenes.dataset import Scenes
from playlearn.scenes.render import SceneEnvironment, render_scenes, scene_sizes

__all__ = ["SceneEnvironment", "Scenes", "ScenesConfig", "render_scenes", "scene_sizes"]
