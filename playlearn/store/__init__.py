"""Episodes at rest."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from playlearn.config import from_dict
from playlearn.store.base import Store, StoreConfig, StoreSpec, with_images
from playlearn.store.blind import BlindStore
from playlearn.store.folder import episode_path
from playlearn.store.lerobot import LeRobotStoreConfig
from playlearn.store.native import NativeStore, NativeStoreConfig, Writer, write_episode

__all__ = [
    "BlindStore",
    "LeRobotStoreConfig",
    "NativeStore",
    "NativeStoreConfig",
    "Store",
    "StoreConfig",
    "StoreSpec",
    "Writer",
    "episode_path",
    "open_store",
    "parse_store",
    "with_images",
    "write_episode",
]


def parse_store(raw: Any) -> Path | StoreConfig:
    """Parse `store:` of a saved config: a folder, or a kind with its settings."""
    return from_dict(StoreConfig, raw) if isinstance(raw, Mapping) else Path(raw)


def open_store(where: Path | str | StoreConfig, *, blind: bool = False) -> Store:
    """Open a store from its config, or the store of any kind in a folder; raises StoreError if there is none.

    blind: as a robot would have recorded it, see `BlindStore`.
    """
    if blind:
        return BlindStore(open_store(where))
    if isinstance(where, StoreConfig):
        return where.build()
    kinds = map(StoreConfig.get_choice_class, StoreConfig.get_known_choices())
    found = next((config for kind in kinds if (config := kind.at(Path(where))) is not None), None)
    return NativeStore.open(where) if found is None else found.build()
