"""OGBench's manipulation environments, its play and its evaluation; they need the extra `ogbench`."""

from playlearn.envs.ogbench.config import OgbenchCubeConfig, OgbenchPlayConfig, OgbenchSceneConfig

__all__ = ["OgbenchCubeConfig", "OgbenchPlayConfig", "OgbenchSceneConfig"]
