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
    config = where if isinstance(where, StoreConfig) else _config_of(Path(where))
    return BlindStore(config.without_objects().build()) if blind else config.build()


def _config_of(folder: Path) -> StoreConfig:
    """The config of the store in a folder, a native one where no other kind is found."""
    kinds = map(StoreConfig.get_choice_class, StoreConfig.get_known_choices())
    found = next((config for kind in kinds if (config := kind.at(folder)) is not None), None)
    return NativeStoreConfig(folder) if found is None else found
