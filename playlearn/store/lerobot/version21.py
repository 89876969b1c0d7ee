"""The layout of version 2.1: metadata in lines of JSON, a file of numbers and a video of each camera for each episode.

meta/info.json   meta/episodes.jsonl   meta/tasks.jsonl   meta/episodes_stats.jsonl (not read)
data/chunk-000/episode_000000.parquet          images are in it, as in version 3.0
videos/chunk-000/<feature>/episode_000000.mp4
"""

import json
from collections.abc import Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any

from playlearn.errors import StoreError
from playlearn.store.lerobot.files import INFO, UNREADABLE, Clip, Row, first_line, inside, template

EPISODES, TASKS = "meta/episodes.jsonl", "meta/tasks.jsonl"
PLACE = ("episode_chunk", "episode_index")
DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
CHUNK = 1000  # episodes of a folder, where `info.json` does not say


class Version21:
    """See `Layout`."""

    version = "2.1"
    tasks = TASKS

    def rows(self, root: Path, info: Mapping[str, Any], videos: Mapping[str, str]) -> tuple[Row, ...]:
        data = template(root, info, "data_path", DATA_PATH, *PLACE)
        video = template(root, info, "video_path", VIDEO_PATH, *PLACE, "video_key")
        listed = sorted((index, length) for index, length in _pairs(root / EPISODES, "episode_index", "length", int))
        begins = accumulate((length for _, length in listed), initial=0)
        try:
            fps, chunk = float(info["fps"]), int(info.get("chunks_size") or CHUNK)
            rows = []
            for (index, length), begin in zip(listed, begins, strict=False):
                place = {"episode_chunk": index // chunk, "episode_index": index}
                clips = {
                    name: Clip(inside(video, video_key=key, **place), 0.0, length / fps) for name, key in videos.items()
                }
                rows.append(Row(index, length, begin, inside(data, **place), clips))
        except (*UNREADABLE, ZeroDivisionError) as error:
            raise StoreError(f"{root / INFO} cannot be read ({first_line(error)}): fetch it again") from error
        return tuple(rows)

    def texts(self, root: Path) -> dict[int, str]:
        found: dict[int, str] = {}
        for index, text in _pairs(root / TASKS, "task_index", "task", str):
            if found.setdefault(index, text) != text:
                raise StoreError(f"{root / TASKS} has two texts for task_index {index}: fetch it again")
        return found


def _pairs[T](path: Path, index: str, value: str, kind: type[T]) -> list[tuple[int, T]]:
    """Two fields of each line of JSON, a whole number and one of a kind; raises StoreError that names a broken line."""
    if not path.is_file():
        raise StoreError(f"{path} is missing: fetch it again")
    pairs = []
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            if type(entry[index]) is not int or type(entry[value]) is not kind:
                raise ValueError(f"{index} {entry[index]!r:.40}, {value} {entry[value]!r:.40}")
            pairs.append((entry[index], entry[value]))
        except UNREADABLE as error:
            raise StoreError(f"{path}, line {number}, cannot be read ({first_line(error)}): fetch it again") from error
    return pairs
