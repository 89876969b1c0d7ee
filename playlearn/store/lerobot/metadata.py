"""The metadata of a LeRobot v3.0 dataset, read without trust: no path leaves its folder, nothing is unpickled."""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from string import Formatter
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from playlearn.errors import MissingStoreError, StoreError
from playlearn.quantity import KINDS, Bounds, kind
from playlearn.store.lerobot.features import Camera, check_features, read_cameras, vector_size
from playlearn.store.lerobot.names import read_names

INFO = "meta/info.json"
TASKS = "meta/tasks.parquet"
EPISODES = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
QUANTITIES, BOUNDS = "quantities", "bounds"  # what a feature's numbers measure, and between what an action lies
PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, pa.ArrowException)


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
    remarks: camera feature -> why it is left out, or not under its short name.
    episodes: total that `info.json` states.
    frames: total that `info.json` states.
    rows: the episodes that the metadata lists.
    tasks: task index -> its text.
    """

    root: Path
    fps: float
    robot: str
    features: Mapping[str, Any]
    cameras: Mapping[str, Camera]
    remarks: Mapping[str, str]
    episodes: int
    frames: int
    rows: tuple[Row, ...]
    tasks: Mapping[int, str]

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
        if not version.startswith("3."):
            raise StoreError(_other_version(root, version))
        features = check_features(path, info["features"])
        fps, episodes, frames = float(info["fps"]), int(info["total_episodes"]), int(info["total_frames"])
        data = _template(info.get("data_path") or DATA_PATH, {"chunk_index", "file_index"})
        video = _template(info.get("video_path") or VIDEO_PATH, {"chunk_index", "file_index", "video_key"})
    except UNREADABLE as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error
    if not 0 < fps < math.inf:
        raise StoreError(f"{path}: fps must be above 0, not {fps:g}")
    cameras, remarks = read_cameras(features)
    return DatasetMetadata(
        root=root,
        fps=fps,
        robot=str(info.get("robot_type") or "unknown"),
        features=features,
        cameras=cameras,
        remarks=remarks,
        episodes=episodes,
        frames=frames,
        rows=_rows(root, data, video, {name: camera.key for name, camera in cameras.items() if camera.video}),
        tasks=_tasks(root) if info.get("total_tasks") or (root / TASKS).is_file() else {},
    )


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
            twice = [name for name in columns or there if there.count(name) > 1]
            if twice:
                raise ValueError(f"it has two columns {twice[0]!r}")
            return file.read(columns=None if columns is None else [name for name in columns if name in there])
    except UNREADABLE as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error


def column_types(path: Path) -> dict[str, pa.DataType]:
    """The columns of a table; none where it cannot be read, which `read_parquet` says."""
    with suppress(*UNREADABLE):
        schema = pq.read_schema(path)
        return dict(zip(schema.names, schema.types, strict=True))
    return {}


def _rows(root: Path, data: str, video: str, videos: Mapping[str, str]) -> tuple[Row, ...]:
    """data, video: templates of the files' paths; videos: camera -> its feature."""
    wanted = ["episode_index", "length", "dataset_from_index", "data/chunk_index", "data/file_index"]
    places = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
    wanted += [f"videos/{key}/{place}" for key in videos.values() for place in places]
    rows: list[Row] = []
    for path in sorted((root / EPISODES).glob("*/*.parquet")):
        table = read_parquet(path, wanted)
        missing = [name for name in wanted if name not in table.column_names]
        if missing:
            raise StoreError(f"{path} has no {', '.join(missing)}: fetch it again")
        try:
            rows += [_row(row, data, video, videos) for row in table.to_pylist()]
        except UNREADABLE as error:
            raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error
    return tuple(sorted(rows, key=lambda row: row.index))


def _row(row: Mapping[str, Any], data: str, video: str, videos: Mapping[str, str]) -> Row:
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
    return Row(int(row["episode_index"]), int(row["length"]), int(row["dataset_from_index"]), place, clips)


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


def _tasks(root: Path) -> dict[int, str]:
    """Task index -> its text; raises StoreError where the table is missing, or holds something else."""
    table, path = read_parquet(root / TASKS), root / TASKS
    # The text is the table's index for pandas, which calls it what it likes.
    texts = [name for name in table.column_names if str(table[name].type) in ("string", "large_string")]
    column = next((name for name in ("task", "__index_level_0__", *texts) if name in texts), None)
    if column is None or "task_index" not in table.column_names:
        raise StoreError(f"{path} has the columns {', '.join(table.column_names)}, not task_index and the task's text")
    rows = list(zip(table["task_index"].to_pylist(), table[column].to_pylist(), strict=True))
    found = {index: text for index, text in rows if index is not None and text is not None}
    if len(found) < len({row for row in rows if None not in row}):
        raise StoreError(f"{path} has two texts for one task_index: fetch it again")
    return found


def _other_version(root: Path, version: str) -> str:
    found = f"{root} is a LeRobot dataset of version {version}; version 3.0 is read here"
    if not version.startswith(("1.", "2.")):
        return f"{found}: update playlearn"
    before = "" if version.startswith("2.1") else "Make it 2.1 with the converters of a LeRobot before 0.4, then c"
    return (
        f"{found}. {before or 'C'}onvert a copy of it: `python -m lerobot.scripts.convert_dataset_v21_to_v30 "
        f"--repo-id=local/{root.name} --root={root} --push-to-hub=false`"
    )


def first_line(error: BaseException) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return f"no {text}" if isinstance(error, KeyError) else text
