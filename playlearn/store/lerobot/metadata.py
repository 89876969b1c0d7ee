"""The metadata of a LeRobot dataset, read without trust: no path leaves its folder, nothing is unpickled."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playlearn.errors import MissingStoreError, StoreError
from playlearn.quantity import KINDS, Bounds, kind
from playlearn.store.lerobot.features import Camera, check_features, read_cameras, vector_size
from playlearn.store.lerobot.files import INFO, UNREADABLE, Layout, Row, first_line
from playlearn.store.lerobot.names import read_names
from playlearn.store.lerobot.version21 import Version21
from playlearn.store.lerobot.version30 import Version30

QUANTITIES, BOUNDS = "quantities", "bounds"  # what a feature's numbers measure, and between what an action lies
PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
CONVERTERS = ("v2.convert_dataset_v1_to_v2", "v21.convert_dataset_v20_to_v21")  # of LeRobot 0.3.3
LAYOUTS: tuple[Layout, ...] = (Version30(), Version21())


@dataclass(frozen=True)
class DatasetMetadata:
    """What `meta/` of a dataset says.

    root: folder of the dataset.
    fps: frames a second.
    robot: LeRobot's `robot_type`.
    features: name -> description, as in `info.json`.
    cameras: name -> Camera, color images only.
    remarks: camera feature -> why it is left out, or not under its short name.
    episodes: total that `info.json` states.
    frames: total that `info.json` states.
    rows: the episodes that the metadata lists.
    tasks: task index -> its text.
    tasks_file: where they are.
    """

    root: Path
    version: str
    fps: float
    robot: str
    features: Mapping[str, Any]
    cameras: Mapping[str, Camera]
    remarks: Mapping[str, str]
    episodes: int
    frames: int
    rows: tuple[Row, ...]
    tasks: Mapping[int, str]
    tasks_file: str

    def names(self, key: str) -> tuple[str, ...]:
        """Name of each dimension of a vector, all different; () if there is no such feature."""
        return self._named(key)[0]

    def renamed(self, key: str) -> str:
        """Why the names of a vector are not the recorded ones; "" if they are."""
        return self._named(key)[1]

    def _named(self, key: str) -> tuple[tuple[str, ...], str]:
        if key not in self.features:
            return (), ""
        feature = self.features[key]
        return read_names(key, feature.get("names"), vector_size(key, feature))

    def quantities(self, key: str) -> tuple[str, ...]:
        """What each dimension of a feature measures (see `quantity.py`); () where nobody said.

        Raises:
            StoreError: it is not said of each dimension, or of a kind that is not known.
        """
        given = self.features.get(key, {}).get(QUANTITIES)
        if given is None:
            return ()
        size = len(self.names(key))
        known = isinstance(given, list) and all(text == "" or kind(str(text)) in KINDS for text in given)
        if not known or len(given) != size:
            raise StoreError(
                f"{self.root / INFO}: {QUANTITIES} of {key} must give each of its {size} numbers a kind "
                f"({', '.join(KINDS)}) and a group, or an empty text: {given}"
            )
        return tuple(map(str, given))

    def bounds(self, key: str) -> Bounds:
        """The lowest and highest value of each dimension of a feature, None without; () where nobody said.

        Raises:
            StoreError: they are not two rising numbers, or none, of each dimension.
        """
        given = self.features.get(key, {}).get(BOUNDS)
        if given is None:
            return ()
        try:
            pairs = tuple(None if pair is None else (float(pair[0]), float(pair[1])) for pair in given)
            sound = len(pairs) == len(self.names(key)) and all(pair is None or pair[0] < pair[1] for pair in pairs)
        except UNREADABLE:
            sound = False
        if not sound:
            raise StoreError(
                f"{self.root / INFO}: {BOUNDS} of {key} must give each of its {len(self.names(key))} numbers "
                f"[lowest, highest] or null: {given}"
            )
        return pairs


def is_lerobot(root: Path) -> bool:
    return (root / INFO).is_file()


def load_metadata(root: Path) -> DatasetMetadata:
    """Read `meta/`.

    Raises:
        StoreError: no dataset is there, it is of another version, a file of `meta/` is missing, broken or a pickle.
    """
    if not is_lerobot(root):
        raise MissingStoreError(
            f"there is no LeRobot dataset at {root} (no {INFO}): give the folder that holds `meta/`"
        )
    for path in root.rglob("*"):
        if path.suffix in PICKLES:
            raise StoreError(f"{path} is a pickle, which can run code when it is read: remove it, no dataset needs one")
    path = root / INFO
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        version = str(info["codebase_version"]).lstrip("v")
        layout = next((one for one in LAYOUTS if version.startswith(one.version)), None)
        if layout is None:
            raise StoreError(_other_version(root, version))
        features = check_features(path, info["features"])
        fps, episodes, frames = float(info["fps"]), int(info["total_episodes"]), int(info["total_frames"])
    except UNREADABLE as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error
    if not 0 < fps < math.inf:
        raise StoreError(f"{path}: fps must be above 0, not {fps:g}")
    cameras, remarks = read_cameras(features)
    return DatasetMetadata(
        root=root,
        version=version,
        fps=fps,
        robot=str(info.get("robot_type") or "unknown"),
        features=features,
        cameras=cameras,
        remarks=remarks,
        episodes=episodes,
        frames=frames,
        rows=layout.rows(root, info, {name: camera.key for name, camera in cameras.items() if camera.video}),
        tasks=layout.texts(root) if info.get("total_tasks") or (root / layout.tasks).is_file() else {},
        tasks_file=layout.tasks,
    )


def _other_version(root: Path, version: str) -> str:
    found = f"{root} is a LeRobot dataset of version {version}; versions 2.1 and 3.0 are read here"
    if not version.startswith(("1.", "2.")):
        return f"{found}: update playlearn"
    scripts = CONVERTERS[1 if version.startswith("2.") else 0 :]
    return (
        f"{found}. Convert it to 2.1 with LeRobot's own converter, which LeRobot 0.3.3 still has (`pip install "
        f"lerobot==0.3.3`, in an environment of its own): "
        + ", then ".join(f"`python -m lerobot.datasets.{script} --repo-id=...`" for script in scripts)
    )
