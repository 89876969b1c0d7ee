"""Config of a LeRobot dataset that is read as play."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from playlearn.errors import UsageError
from playlearn.store.base import StoreConfig

if TYPE_CHECKING:
    from playlearn.store.lerobot.reader import LeRobotStore


@StoreConfig.register_subclass("lerobot")
@dataclass(frozen=True)
class LeRobotStoreConfig(StoreConfig):
    """A LeRobot dataset, v3.0 or in the layout of v2.1, in a folder or on the Hub.

    root: folder of the dataset.
    repo_id: name of the dataset on the Hub; LeRobot's own folders are searched first.
    revision: of the dataset on the Hub (null: the tag of the format's version).
    state: feature of the robot's proprioception.
    achieved: feature of the objects; settled moments are read from the robot if the dataset has no such feature, or if
        this is "".
    goal_names: shell-style patterns of its dimensions that goals are about (null: all that do not change with the hand
        while nothing else does).
    action: feature of the commanded actions.
    image_size: (height, width) that every camera is scaled to (null: its own size).
    cache: folder of the decoded frames (null: the user's cache folder).
    without_images: read the numbers only.
    skip_broken: leave out the episodes that cannot be read.
    success: which episodes succeeded, a rule such as `all`, `none`, `dones`, `reward>=1` or `last_reward>=0` (null: as
        `next.success` says, else unknown).

    LeRobot does not say what a number measures. Each dimension therefore has its own mean, spread and thresholds, and
    no bounds, unless features of `meta/info.json` say more, as those that `export lerobot` writes do: `quantities`, a
    text a dimension (see `quantity.py`), and `bounds` of actions, `[lowest, highest]` or null.
    """

    root: Path | None = None
    repo_id: str | None = None
    revision: str | None = None
    state: str = "observation.state"
    achieved: str = "observation.environment_state"
    goal_names: tuple[str, ...] | None = None
    action: str = "action"
    image_size: tuple[int, int] | None = None
    cache: Path | None = None
    without_images: bool = False
    skip_broken: bool = False
    success: str | None = None

    def __post_init__(self) -> None:
        """Raises UsageError where no dataset is named, or two are."""
        if (self.root is None) == (self.repo_id is None):
            raise UsageError("a LeRobot dataset is named by its folder (root) or by its name on the Hub (repo_id)")
        if self.image_size is not None and min(self.image_size) < 1:
            raise UsageError(f"image_size must be (height, width) in pixels, got {self.image_size}")

    @classmethod
    def at(cls, folder: Path) -> "LeRobotStoreConfig | None":
        return cls(root=folder) if (folder / "meta" / "info.json").is_file() else None

    def without_objects(self) -> "LeRobotStoreConfig":
        return replace(self, achieved="", goal_names=None, success=None)

    def build(self) -> "LeRobotStore":
        # Slow to import, and every command imports the stores' configs.
        from playlearn.store.lerobot.hub import find_dataset
        from playlearn.store.lerobot.reader import LeRobotStore

        root = self.root
        if root is None:
            root = find_dataset(str(self.repo_id), self.revision, with_videos=not self.without_images)
        return LeRobotStore(
            root,
            state=self.state,
            achieved=self.achieved,
            goal_names=self.goal_names,
            action=self.action,
            image_size=self.image_size,
            cache=self.cache,
            without_images=self.without_images,
            skip_broken=self.skip_broken,
            success=self.success,
        )
