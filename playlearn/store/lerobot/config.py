"""How a LeRobot dataset is read as play."""

import os
from dataclasses import dataclass
from pathlib import Path

from playlearn.errors import UsageError
from playlearn.store.base import Store, StoreConfig


@StoreConfig.register_subclass("lerobot")
@dataclass(frozen=True)
class LeRobotStoreConfig(StoreConfig):
    """A dataset in a folder (root), or one of the Hub by its name (repo_id), looked for in LeRobot's own folders first.

    revision: of the Hub's dataset. state, achieved, action: the features that are the robot's own body, the objects
    (() where it has none: settled moments are then read from the robot) and what was commanded.
    image_size: (height, width) that every camera is scaled to; null for their own. cache: where decoded frames are
    kept; null for the user's cache folder. without_images: only the numbers. skip_broken: go on without the episodes
    that cannot be read.
    """

    root: Path | None = None
    repo_id: str | None = None
    revision: str | None = None
    state: str = "observation.state"
    achieved: str = "observation.environment_state"
    action: str = "action"
    image_size: tuple[int, int] | None = None
    cache: Path | None = None
    without_images: bool = False
    skip_broken: bool = False

    def __post_init__(self) -> None:
        """Raises UsageError where no dataset is named, or two are."""
        if (self.root is None) == (self.repo_id is None):
            raise UsageError("a LeRobot dataset is named by its folder (root) or by its name on the Hub (repo_id)")
        if self.image_size is not None and min(self.image_size) < 1:
            raise UsageError(f"image_size must be (height, width) in pixels, got {self.image_size}")

    @classmethod
    def at(cls, folder: Path) -> "LeRobotStoreConfig | None":
        return cls(root=folder) if (folder / "meta" / "info.json").is_file() else None

    def build(self) -> Store:
        from playlearn.store.lerobot.reader import LeRobotStore  # heavy, and every command imports the store

        return LeRobotStore(self)


def cache_folder() -> Path:
    """Where decoded frames are kept unless the config says otherwise."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "playlearn" / "frames"
