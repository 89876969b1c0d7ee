"""Skills as LeRobot's subtask annotation: `language_persistent`, rows that are valid from their timestamp on.

Each frame of an episode carries all of its rows, as `lerobot-annotate` writes them; the file is rewritten with one row
group an episode.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

PERSISTENT, EVENTS = "language_persistent", "language_events"


def annotate(root: Path, subtasks: Mapping[int, Sequence[tuple[int, str]]], fps: float) -> None:
    """Add both language columns to a dataset. subtasks: episode -> (first frame, name)."""
    from lerobot.datasets.io_utils import write_table_one_row_group_per_episode
    from lerobot.datasets.language import language_feature_info

    for path in sorted((root / "data").glob("*/*.parquet")):
        table = pq.read_table(path)
        owners = np.asarray(table["episode_index"])
        own = [_rows(subtasks[e], fps) for e in dict.fromkeys(owners.tolist())]
        counts = np.unique(owners, return_counts=True)[1].tolist()
        repeated = pa.concat_arrays([pa.concat_arrays([rows] * n) for rows, n in zip(own, counts, strict=True)])
        table = table.append_column(PERSISTENT, repeated).append_column(EVENTS, _no_events(len(table)))
        written = path.with_suffix(".tmp")
        write_table_one_row_group_per_episode(table, written)
        written.replace(path)
    info = json.loads((root / "meta/info.json").read_text())
    language = {key: {**feature, "shape": list(feature["shape"])} for key, feature in language_feature_info().items()}
    (root / "meta/info.json").write_text(json.dumps({**info, "features": {**info["features"], **language}}, indent=4))


def _rows(subtasks: Sequence[tuple[int, str]], fps: float) -> pa.ListArray:
    """One list with every subtask of an episode."""
    n = len(subtasks)
    return pa.ListArray.from_arrays(
        [0, n],
        _structs(
            role=pa.array(["user"] * n, pa.string()),
            content=pa.array([name for _, name in subtasks], pa.string()),
            style=pa.array(["subtask"] * n, pa.string()),
            timestamp=pa.array([at / fps for at, _ in subtasks], pa.float32()),
        ),
    )


def _no_events(count: int) -> pa.ListArray:
    """`count` empty lists of events."""
    none = {name: pa.nulls(0, pa.string()) for name in ("role", "content", "style")}
    return pa.ListArray.from_arrays([0] * (count + 1), _structs(**none))


def _structs(**parts: pa.Array) -> pa.StructArray:
    """Rows without camera or tool calls. Built from arrays, as pyarrow makes no JSON of Python objects."""
    n = len(parts["role"])
    unused = {"camera": pa.nulls(n, pa.string()), "tool_calls": pa.nulls(n, pa.list_(pa.json_()))}
    return pa.StructArray.from_arrays([*parts.values(), *unused.values()], names=[*parts, *unused])
