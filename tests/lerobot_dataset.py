"""LeRobot datasets as they lie on disk, written without LeRobot: any `info.json`, any columns; v3.0 or v2.1."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from playlearn.episode import Array

DATA, EPISODES, TASKS = (
    "data/chunk-000/file-000.parquet",
    "meta/episodes/chunk-000/file-000.parquet",
    "meta/tasks.parquet",
)
BOOKKEEPING = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    **{
        key: {"dtype": "int64", "shape": [1], "names": None}
        for key in ("frame_index", "episode_index", "index", "task_index")
    },
}


def vector(names: Any, size: int | None = None, dtype: str = "float32") -> dict[str, Any]:
    """The description of a feature of `size` numbers (null: as many as there are names)."""
    return {"dtype": dtype, "shape": [len(names) if size is None else size], "names": names}


def image(*shape: int, names: Sequence[str] = ("height", "width", "channels")) -> dict[str, Any]:
    return {"dtype": "image", "shape": list(shape), "names": list(names)}


def encoded(frames: Array | Sequence[Array], mode: str | None = None) -> list[dict[str, Any]]:
    """Cells of an image column: each frame as PNG."""
    cells = []
    for frame in frames:
        buffer = io.BytesIO()
        Image.fromarray(frame, mode).save(buffer, "PNG")
        cells.append({"bytes": buffer.getvalue(), "path": None})
    return cells


def write_dataset(
    root: Path,
    features: Mapping[str, Any],
    columns: Mapping[str, Any],
    lengths: Sequence[int],
    tasks: Sequence[Sequence[str]] | None = None,
    fps: int = 20,
) -> Path:
    """A dataset in `root`.

    features: as in `info.json`, besides LeRobot's own five.
    columns: feature -> a value a frame of all episodes, or a pyarrow array.
    lengths: frames of each episode.
    tasks: of each frame, by episode (null: "play").
    """
    frame = np.concatenate([np.arange(n) for n in lengths])
    own = [text for episode in tasks or [["play"] * n for n in lengths] for text in episode]
    texts = list(dict.fromkeys(own))
    table = {
        **{key: value if isinstance(value, pa.Array) else pa.array(list(value)) for key, value in columns.items()},
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "index": np.arange(len(frame)),
        "task_index": [texts.index(text) for text in own],
    }
    begins = [int(sum(lengths[:k])) for k in range(len(lengths))]
    places = {"data/chunk_index": [0] * len(lengths), "data/file_index": [0] * len(lengths)}
    _write(root / DATA, table)
    _write(
        root / EPISODES,
        {"episode_index": range(len(lengths)), "length": lengths, "dataset_from_index": begins} | places,
    )
    _write(root / TASKS, {"task_index": range(len(texts)), "task": texts})
    info = {
        "codebase_version": "v3.0",
        "robot_type": "so100_follower",
        "fps": fps,
        "total_episodes": len(lengths),
        "total_frames": len(frame),
        "total_tasks": len(texts),
        "features": {**features, **BOOKKEEPING},
    }
    (root / "meta" / "info.json").write_text(json.dumps(info))
    return root


def as_version21(source: Path, root: Path) -> Path:
    """The dataset of `source`, which `write_dataset` wrote, in the layout of v2.1, as LeRobot 0.3 wrote it."""
    table, info = pq.read_table(source / DATA), json.loads((source / "meta" / "info.json").read_text())
    tasks = pq.read_table(source / TASKS).to_pylist()
    owner, lengths = np.asarray(table["episode_index"]), pq.read_table(source / EPISODES)["length"].to_pylist()
    for k in range(len(lengths)):
        path = root / f"data/chunk-000/episode_{k:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.filter(pa.array(owner == k)), path)
    stats = {"action": {name: [1.0] for name in ("min", "max", "mean", "std")} | {"count": [lengths[0]]}}
    lines = {
        "episodes": [{"episode_index": k, "tasks": [], "length": n} for k, n in enumerate(lengths)],
        "episodes_stats": [{"episode_index": k, "stats": stats} for k in range(len(lengths))],
        "tasks": tasks,
    }
    (root / "meta").mkdir()
    for name, entries in lines.items():
        (root / f"meta/{name}.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    own = {
        "codebase_version": "v2.1",
        "total_chunks": 1,
        "total_videos": 0,
        "chunks_size": 1000,
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    }
    (root / "meta" / "info.json").write_text(json.dumps(info | own))
    return root


def change_info(root: Path, **changed: Any) -> None:
    path = root / "meta" / "info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))


def add_column(root: Path, key: str, feature: Mapping[str, Any], values: Sequence[Any]) -> None:
    """Add a feature, with a value a frame, to a dataset that is there."""
    info = json.loads((root / "meta" / "info.json").read_text())
    change_info(root, features={**info["features"], key: feature})
    table = pq.read_table(root / DATA)
    pq.write_table(table.append_column(key, pa.array(list(values))), root / DATA)


def _write(path: Path, columns: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    made = {key: value if isinstance(value, pa.Array) else pa.array(list(value)) for key, value in columns.items()}
    pq.write_table(pa.table(made), path)
