"""Episodes at rest."""

from pathlib import Path

from playlearn.store.base import Store, StoreConfig, StoreSpec, with_images
from playlearn.store.folder import episode_path
from playlearn.store.lerobot import LeRobotStoreConfig
from playlearn.store.native import NativeStore, NativeStoreConfig, Writer, write_episode

__all__ = [
    "LeRobotStoreConfig",
    "NativeStore",
    "NativeStoreConfig",
    "Store",
    "StoreConfig",
    "StoreSpec",
    "Writer",
    "episode_path",
    "open_store",
    "with_images",
    "write_episode",
]


def open_store(where: Path | str | StoreConfig) -> Store:
    """The store that a config describes, or that lies in a folder, of whatever kind. Raises StoreError for none."""
    if isinstance(where, StoreConfig):
        return where.build()
    kinds = map(StoreConfig.get_choice_class, StoreConfig.get_known_choices())
    found = next((config for kind in kinds if (config := kind.at(Path(where))) is not None), None)
    return NativeStore.open(where) if found is None else found.build()
