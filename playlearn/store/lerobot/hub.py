"""Where a dataset is: in a folder, in LeRobot's own folders, or fetched from the Hub because it was named so."""

import os
from pathlib import Path

from playlearn.errors import StoreError
from playlearn.store.lerobot.config import LeRobotStoreConfig
from playlearn.store.lerobot.metadata import is_lerobot

TAG = "v3.0"  # under which a dataset of this version stands on the Hub


def resolve_dataset(config: LeRobotStoreConfig) -> Path:
    """The dataset's folder.

    Raises:
        StoreError: there is none, or the Hub cannot be reached.
    """
    if config.root is not None:
        return config.root
    name = str(config.repo_id)
    home = Path(os.environ.get("HF_HOME") or Path.home() / ".cache" / "huggingface")
    local = Path(os.environ.get("HF_LEROBOT_HOME") or home / "lerobot") / name
    return local if ".." not in Path(name).parts and is_lerobot(local) else _fetched(config, name, local)


def _fetched(config: LeRobotStoreConfig, name: str, local: Path) -> Path:
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import (
        HfHubHTTPError,
        HFValidationError,
        LocalEntryNotFoundError,
        OfflineModeIsEnabled,
        RepositoryNotFoundError,
        RevisionNotFoundError,
    )

    leave = ["videos/*"] if config.without_images else None
    try:
        try:
            return Path(
                snapshot_download(name, repo_type="dataset", revision=config.revision or TAG, ignore_patterns=leave)
            )
        except RevisionNotFoundError:
            if config.revision:
                raise
            return Path(snapshot_download(name, repo_type="dataset", ignore_patterns=leave))
    except HFValidationError as error:
        raise StoreError(f"{name!r} is no name of a dataset on the Hub: it is `user/name`") from error
    except RevisionNotFoundError as error:
        raise StoreError(f"the dataset {name} on the Hub has no revision {config.revision!r}") from error
    except RepositoryNotFoundError as error:
        raise StoreError(
            f"there is no dataset {name} on the Hub, nor at {local}: check the name; a private one: `hf auth login`"
        ) from error
    except (LocalEntryNotFoundError, OfflineModeIsEnabled, HfHubHTTPError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StoreError(
            f"{name} is not at {local}, and the Hub cannot be reached ({reason}): name its folder (`root`), or "
            "try again with a network"
        ) from error
