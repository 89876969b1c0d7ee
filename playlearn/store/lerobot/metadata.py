"""The metadata of a LeRobot v3.0 dataset, read without trust: no path leaves its folder, nothing is unpickled."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from string import Formatter
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from playlearn.episode import IMAGES
from playlearn.errors import StoreError
from playlearn.quantity import KINDS, Bounds, kind

INFO = "meta/info.json"
TASKS = "meta/tasks.parquet"
EPISODES = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
QUANTITIES, BOUNDS = "quantities", "bounds"  # what a feature's numbers measure, and between what an action lies
PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, pa.ArrowException)


@dataclass(frozen=True)
class Camera:
    """A camera of the dataset.

    key: name of the feature.
    size: (height, width).
    video: frames are in a video file, not in the parquet file.
    """

    key: str
    size: tuple[int, int]
    video: bool


@dataclass(frozen=True)
class Clip:
    """The part of a video that holds an episode's frames; begin and end in seconds."""

    file: str
    begin: float
    end: float


@dataclass(frozen=True)
class Row:
    """One episode.

    index: of the episode.
    length: frames.
    begin: index of its first frame in the whole dataset.
    data: the parquet file that holds its numbers.
    clips: camera -> part of a video.
    """

    index: int
    length: int
    begin: int
    data: str
    clips: Mapping[str, Clip]


@dataclass(frozen=True)
class DatasetMetadata:
    """What `meta/` of a dataset says.

    root: folder of the dataset.
    fps: frames a second.
    robot: LeRobot's `robot_type`.
    features: name -> description, as in `info.json`.
    cameras: name -> Camera, color images only.
    episodes: total that `info.json` states.
    frames: total that `info.json` states.
    rows: the episodes that the metadata lists.
    tasks: name of each task index.
    """

    root: Path
    fps: float
    robot: str
    features: Mapping[str, Any]
    cameras: Mapping[str, Camera]
    episodes: int
    frames: int
    rows: tuple[Row, ...]
    tasks: tuple[str, ...]

    def names(self, key: str) -> tuple[str, ...]:
        """Name of each dimension of a feature; () if there is no such feature."""
        if key not in self.features:
            return ()
        size = int(self.features[key]["shape"][0])
        names = self.features[key].get("names")
        while isinstance(names, dict):  # {"motors": [...]}, as early recordings have it
            names = [name for part in names.values() for name in (part if isinstance(part, list) else [part])]
        part = key.removeprefix("observation.")
        return tuple(map(str, names)) if names and len(names) == size else tuple(f"{part}.{i}" for i in range(size))

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
        raise StoreError(f"there is no LeRobot dataset at {root} (no {INFO}): give the folder that holds `meta/`")
    for path in root.rglob("*"):
        if path.suffix in PICKLES:
            raise StoreError(f"{path} is a pickle, which can run code when it is read: remove it, no dataset needs one")
    try:
        info = json.loads((root / INFO).read_text(encoding="utf-8"))
        version = str(info["codebase_version"]).lstrip("v")
        if not version.startswith("3."):
            raise StoreError(_other_version(root, version))
        features = dict(info["features"])
        metadata = DatasetMetadata(
            root=root,
            fps=float(info["fps"]),
            robot=str(info.get("robot_type") or "unknown"),
            features=features,
            cameras=_cameras(features),
            episodes=int(info["total_episodes"]),
            frames=int(info["total_frames"]),
            rows=_rows(root, info, _cameras(features)),
            tasks=_tasks(root) if info.get("total_tasks") else (),
        )
    except UNREADABLE as error:
        raise StoreError(f"{root / INFO} cannot be read ({first_line(error)}): fetch it again") from error
    if not metadata.fps > 0:
        raise StoreError(f"{root / INFO}: fps must be above 0, not {metadata.fps:g}")
    return metadata


def read_parquet(path: Path, columns: list[str] | None = None) -> pa.Table:
    """A table, or those of the columns that are there.

    Raises:
        StoreError: it is missing or cannot be read.
    """
    if not path.is_file():
        raise StoreError(f"{path} is missing: fetch it again")
    try:
        with pq.ParquetFile(path) as file:
            there = file.schema_arrow.names
            return file.read(columns=None if columns is None else [name for name in columns if name in there])
    except UNREADABLE as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error


def _rows(root: Path, info: Mapping[str, Any], cameras: Mapping[str, Camera]) -> tuple[Row, ...]:
    videos = {name: camera.key for name, camera in cameras.items() if camera.video}
    wanted = ["episode_index", "length", "dataset_from_index", "data/chunk_index", "data/file_index"]
    places = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
    wanted += [f"videos/{key}/{place}" for key in videos.values() for place in places]
    data = _template(info.get("data_path") or DATA_PATH, {"chunk_index", "file_index"})
    video = _template(info.get("video_path") or VIDEO_PATH, {"chunk_index", "file_index", "video_key"})
    rows = []
    for path in sorted((root / EPISODES).glob("*/*.parquet")):
        table = read_parquet(path, wanted)
        missing = [name for name in wanted if name not in table.column_names]
        if missing:
            raise StoreError(f"{path} has no {', '.join(missing)}: fetch it again")
        for row in table.to_pylist():
            clips = {
                name: Clip(
                    _inside(video, video_key=key, **_file(row, f"videos/{key}/")),
                    float(row[f"videos/{key}/from_timestamp"]),
                    float(row[f"videos/{key}/to_timestamp"]),
                )
                for name, key in videos.items()
                if row[f"videos/{key}/chunk_index"] is not None
            }
            place = _inside(data, **_file(row, "data/"))
            rows.append(Row(row["episode_index"], row["length"], row["dataset_from_index"], place, clips))
    return tuple(sorted(rows, key=lambda row: row.index))


def _file(row: Mapping[str, Any], prefix: str) -> dict[str, int]:
    return {name: int(row[prefix + name]) for name in ("chunk_index", "file_index")}


def _template(template: str, fields: set[str]) -> str:
    """The template itself; refuses one with other fields (`{video_key.__class__}`)."""
    used = {name for _, name, _, _ in Formatter().parse(template) if name is not None}
    if not used <= fields:
        raise StoreError(f"the template {template!r} in {INFO} asks for {', '.join(sorted(used - fields))}: refused")
    return template


def _inside(template: str, **values: Any) -> str:
    """The path that a template gives; refuses a path out of the dataset."""
    path = PurePosixPath(template.format(**values))
    if path.is_absolute() or ".." in path.parts or "\\" in str(path):
        raise StoreError(f"the path {str(path)!r} that {INFO} gives leads out of the dataset: refused")
    return str(path)


def _cameras(features: Mapping[str, Any]) -> dict[str, Camera]:
    """Color cameras; depth maps have one channel and are left out."""
    cameras = {}
    for key, feature in features.items():
        if feature["dtype"] in ("image", "video") and len(feature["shape"]) == 3 and 3 in feature["shape"]:
            first, second, third = (int(size) for size in feature["shape"])
            size = (first, second) if third == 3 else (second, third)  # (h, w, c), seldom (c, h, w)
            name = key.removeprefix(IMAGES).removeprefix("observation.")
            cameras[name] = Camera(key, size, feature["dtype"] == "video")
    return cameras


def _tasks(root: Path) -> tuple[str, ...]:
    table = read_parquet(root / TASKS)
    column = next(name for name in table.column_names if name != "task_index")  # pandas calls an index what it likes
    found = dict(zip(table["task_index"].to_pylist(), table[column].to_pylist(), strict=True))
    return tuple(str(found.get(i, "")) for i in range(max(found, default=-1) + 1))


def _other_version(root: Path, version: str) -> str:
    if version.startswith("2."):
        return (
            f"{root} is a LeRobot dataset of version {version}; version 3.0 is read here. Convert a copy of it: "
            f"`python -m lerobot.scripts.convert_dataset_v21_to_v30 --repo-id=local/{root.name} --root={root} "
            "--push-to-hub=false`"
        )
    return f"{root} is a LeRobot dataset of version {version}; version 3.0 is read here: update playlearn"


def first_line(error: BaseException) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return f"no {text}" if isinstance(error, KeyError) else text
