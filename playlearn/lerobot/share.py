"""Write a dataset with its card and picture, and push it to the Hub."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from playlearn.errors import StoreError
from playlearn.lerobot.goals import GOAL_PROPRIO, RelabelConfig, Windows
from playlearn.report.lerobot_card import PICTURE, CardFacts, lerobot_card, lerobot_picture
from playlearn.store import Store
from playlearn.store.lerobot.content import Content, Play
from playlearn.store.lerobot.export import Codec, Fidelity, ProgressCallback, write_lerobot

TAG = "v3.0"  # tag of this format's datasets on the Hub


def share(
    content: Content, out: Path, videos: Codec | None, progress: ProgressCallback | None = None
) -> dict[str, Fidelity]:
    """Write a LeRobot dataset with its card; see `write_lerobot`."""

    def write_extras(root: Path, fidelity: Mapping[str, Fidelity]) -> None:
        picture = lerobot_picture(content.store, out.name)
        if picture:
            (root / PICTURE).write_bytes(picture)
        features = content.features()
        facts = CardFacts(out.name, len(content), GOAL_PROPRIO in features, bool(picture))
        readback = {camera: str(read) for camera, read in fidelity.items()}
        (root / "README.md").write_text(lerobot_card(content.store, features, readback, facts), encoding="utf-8")

    return write_lerobot(content, out, videos=videos, progress=progress, write_extras=write_extras)


def contents(store: Store, goals: RelabelConfig | None = None, *, subtasks: bool = False) -> Content:
    """The content to write of a store.

    goals: how it is relabeled (None: not at all).
    subtasks: write skills as LeRobot's subtask annotation.
    """
    return Play(store, subtasks) if goals is None else Windows(store, goals, subtasks)


def push(root: Path, repo_id: str, *, private: bool) -> str:
    """Upload a dataset to the Hub and tag it; returns its address.

    Raises:
        StoreError: the Hub refused or cannot be reached; the dataset at `root` is as it was.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.errors import HfHubHTTPError, HFValidationError, OfflineModeIsEnabled, RevisionNotFoundError

    api = HfApi()
    try:
        address = api.create_repo(repo_id, repo_type="dataset", private=private, exist_ok=True)
        api.upload_folder(repo_id=repo_id, folder_path=root, repo_type="dataset")
        with suppress(RevisionNotFoundError):
            api.delete_tag(repo_id, tag=TAG, repo_type="dataset")
        api.create_tag(repo_id, tag=TAG, repo_type="dataset")
    except (HfHubHTTPError, HFValidationError, OfflineModeIsEnabled, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StoreError(
            f"{root} is complete, but could not be uploaded as {repo_id} ({reason}): log in with `hf auth login`, then "
            "push it again with the same command"
        ) from error
    return str(address)
