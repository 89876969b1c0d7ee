"""The layout of version 3.0: metadata in parquet tables, many episodes to a file of numbers and to a video."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from playlearn.errors import StoreError
from playlearn.store.lerobot.files import UNREADABLE, Clip, Row, first_line, inside, read_parquet, template

PLACE = ("chunk_index", "file_index")
EPISODES = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
TASKS = "meta/tasks.parquet"


class Version30:
    """See `Layout`."""

    version = "3."
    tasks = TASKS

    def rows(self, root: Path, info: Mapping[str, Any], videos: Mapping[str, str]) -> tuple[Row, ...]:
        data = template(root, info, "data_path", DATA_PATH, *PLACE)
        video = template(root, info, "video_path", VIDEO_PATH, *PLACE, "video_key")
        wanted = ["episode_index", "length", "dataset_from_index", *(f"data/{name}" for name in PLACE)]
        places = (*PLACE, "from_timestamp", "to_timestamp")
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

    def texts(self, root: Path) -> dict[int, str]:
        table, path = read_parquet(root / TASKS), root / TASKS
        # The text is the table's index for pandas, which calls it what it likes.
        texts = [name for name in table.column_names if str(table[name].type) in ("string", "large_string")]
        column = next((name for name in ("task", "__index_level_0__", *texts) if name in texts), None)
        if column is None or "task_index" not in table.column_names:
            raise StoreError(
                f"{path} has the columns {', '.join(table.column_names)}, not task_index and the task's text"
            )
        rows = list(zip(table["task_index"].to_pylist(), table[column].to_pylist(), strict=True))
        found = {index: text for index, text in rows if index is not None and text is not None}
        if len(found) < len({row for row in rows if None not in row}):
            raise StoreError(f"{path} has two texts for one task_index: fetch it again")
        return found


def _row(row: Mapping[str, Any], data: str, video: str, videos: Mapping[str, str]) -> Row:
    clips = {
        name: Clip(
            inside(video, video_key=key, **_file(row, f"videos/{key}/")),
            float(row[f"videos/{key}/from_timestamp"]),
            float(row[f"videos/{key}/to_timestamp"]),
        )
        for name, key in videos.items()
        if row[f"videos/{key}/chunk_index"] is not None
    }
    place = inside(data, **_file(row, "data/"))
    return Row(int(row["episode_index"]), int(row["length"]), int(row["dataset_from_index"]), place, clips)


def _file(row: Mapping[str, Any], prefix: str) -> dict[str, int]:
    return {name: int(row[prefix + name]) for name in PLACE}
