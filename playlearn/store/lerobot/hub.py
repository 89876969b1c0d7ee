"""Find a dataset by its name: in LeRobot's own folders, or download it from the Hub."""

import os
from pathlib import Path

from playlearn.errors import MissingStoreError, StoreError
from playlearn.store.lerobot.metadata import is_lerobot

TAG = "v3.0"  # tag of datasets of this version on the Hub


def find_dataset(name: str, revision: str | None = None, *, with_videos: bool = True) -> Path:
    """The folder of the dataset `name` (`user/name`).

    revision: of the dataset on the Hub (None: the tag of the format's version).

    Raises:
        MissingStoreError: there is no such dataset.
        StoreError: the Hub cannot be reached.
    """
    home = Path(os.environ.get("HF_HOME") or Path.home() / ".cache" / "huggingface")
    local = Path(os.environ.get("HF_LEROBOT_HOME") or home / "lerobot") / name
    return (
        local if ".." not in Path(name).parts and is_lerobot(local) else _download(name, revision, local, with_videos)
    )


def _download(name: str, revision: str | None, local: Path, with_videos: bool) -> Path:
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import (
        HfHubHTTPError,
        HFValidationError,
        LocalEntryNotFoundError,
        OfflineModeIsEnabled,
        RepositoryNotFoundError,
        RevisionNotFoundError,
    )

    ignored = None if with_videos else ["videos/*"]
    try:
        try:
            return Path(snapshot_download(name, repo_type="dataset", revision=revision or TAG, ignore_patterns=ignored))
        except RevisionNotFoundError:
            if revision:
                raise
            return Path(snapshot_download(name, repo_type="dataset", ignore_patterns=ignored))
    except HFValidationError as error:
        raise MissingStoreError(f"{name!r} is no name of a dataset on the Hub: it is `user/name`") from error
    except RevisionNotFoundError as error:
        raise MissingStoreError(f"the dataset {name} on the Hub has no revision {revision!r}") from error
    except RepositoryNotFoundError as error:
        raise MissingStoreError(
            f"there is no dataset {name} on the Hub, nor at {local}: check the name; a private one: `hf auth login`"
        ) from error
    except (LocalEntryNotFoundError, OfflineModeIsEnabled, HfHubHTTPError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StoreError(
            f"{name} is not at {local}, and the Hub cannot be reached ({reason}): name its folder (`root`), or "
            "try again with a network"
        ) from error
