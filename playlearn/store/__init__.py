"""Episodes at rest."""

from pathlib import Path

from playlearn.store.base import Store, StoreConfig, StoreSpec, with_images
from playlearn.store.folder import episode_path
from playlearn.store.native import NativeStore, NativeStoreConfig, Writer, write_episode

__all__ = [
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


def open_store(path: Path | str) -> Store:
    """The store at `path`. Raises StoreError where there is none."""
    return NativeStore.open(path)
