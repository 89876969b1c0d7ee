"""What is missing or broken in a LeRobot dataset, problem by problem, and which episodes can be used."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import pyarrow as pa

from playlearn.episode import Array
from playlearn.errors import StoreError
from playlearn.store.lerobot.metadata import DatasetMetadata, Row, read_parquet

MAX_LISTED = 40  # problems in one message
NUMBERS = ("episode_index", "frame_index", "index", "timestamp")


@dataclass(frozen=True)
class Problem:
    """Something that is missing or broken.

    message: what is wrong.
    episodes: the ones that cannot be used.
    images: only their images are affected; their numbers can be used.
    """

    message: str
    episodes: frozenset[int] = frozenset()
    images: bool = False


def check_counts(metadata: DatasetMetadata) -> list[Problem]:
    """Compare the totals of `info.json` with the episodes that the metadata lists."""
    listed = {"total_episodes": len(metadata.rows), "total_frames": sum(row.length for row in metadata.rows)}
    stated = {"total_episodes": metadata.episodes, "total_frames": metadata.frames}
    problems = [
        Problem(f"meta/info.json says {name} {stated[name]}, its episodes' metadata makes it {count}")
        for name, count in listed.items()
        if count != stated[name]
    ]
    at = 0
    for row in metadata.rows:
        if row.begin != at:
            problems.append(
                Problem(f"episode {row.index} begins at frame {row.begin} of the dataset, where {at} is next")
            )
        at = row.begin + row.length
    return problems


def read_columns(
    metadata: DatasetMetadata, keys: Sequence[str], shortest: int
) -> tuple[dict[int, dict[str, Array]], list[Problem]]:
    """Episode -> column -> (length, n) float32 for the complete episodes; and what is wrong with the others."""
    found: dict[int, dict[str, Array]] = {}
    problems: list[Problem] = []
    for place, group in groupby(sorted(metadata.rows, key=lambda row: (row.data, row.index)), lambda row: row.data):
        rows = list(group)
        try:
            table = read_parquet(metadata.root / place, [*keys, *NUMBERS])
            lacks = [key for key in (*keys, *NUMBERS) if key not in table.column_names]
            if lacks:
                raise StoreError(f"{metadata.root / place} has no {', '.join(lacks)}: fetch it again")
        except StoreError as error:
            problems.append(Problem(f"{error} ({_episodes(rows)})", _numbers(rows)))
            continue
        owner = np.asarray(table["episode_index"])
        for row in rows:
            mine = np.flatnonzero(owner == row.index)
            own = table.slice(mine[0], mine[-1] - mine[0] + 1) if len(mine) else table.slice(0, 0)
            columns, message = _episode(own, row, keys, metadata.fps, shortest)
            if message:
                problems.append(Problem(f"episode {row.index}: {message}", _numbers([row])))
            else:
                found[row.index] = columns
    return found, problems


def check_videos(metadata: DatasetMetadata, cameras: Iterable[str]) -> list[Problem]:
    """Find videos that are missing, broken, or end before an episode does."""
    from playlearn.store.lerobot.frames import video_seconds

    owners: dict[tuple[str, str], list[Row]] = {}
    problems = []
    for row in metadata.rows:
        for camera in cameras:
            if camera in row.clips:
                owners.setdefault((camera, row.clips[camera].file), []).append(row)
            elif metadata.cameras[camera].video:
                problems.append(Problem(f"episode {row.index} has no video of {camera}", _numbers([row]), images=True))
    for (camera, place), rows in owners.items():
        try:
            if not (metadata.root / place).is_file():
                raise StoreError(f"{metadata.root / place} is missing: fetch it again")
            length = video_seconds(metadata.root / place)
        except StoreError as error:
            problems.append(Problem(f"{error} ({_episodes(rows)})", _numbers(rows), images=True))
            continue
        for row in rows:
            end = row.clips[camera].begin + row.length / metadata.fps
            if length < end - 0.5 / metadata.fps:
                message = f"episode {row.index}: {place} ends at {length:.2f} s, the episode at {end:.2f} s"
                problems.append(Problem(message, _numbers([row]), images=True))
    return problems


def usable_episodes(metadata: DatasetMetadata, problems: Sequence[Problem], skip: bool) -> list[Row]:
    """The episodes that can be used.

    Raises:
        StoreError: something is wrong and `skip` is off, or no episode is left.
    """
    everything = metadata.rows
    broken = frozenset[int]().union(*(problem.episodes for problem in problems))
    whole = [row for row in everything if row.index not in broken]
    if problems and not (skip and whole):
        numberless = frozenset[int]().union(*(problem.episodes for problem in problems if not problem.images))
        raise StoreError(
            _format_problems(metadata.root, problems, len(whole), len(everything), len(everything) - len(numberless))
        )
    if not whole:
        raise StoreError(f"{metadata.root} holds no episodes")
    return whole


def _format_problems(root: Path, problems: Sequence[Problem], whole: int, total: int, without_images: int) -> str:
    lines = [f"{root} is not whole:", *(f"  {problem.message}" for problem in problems[:MAX_LISTED])]
    if len(problems) > MAX_LISTED:
        lines.append(f"  and {len(problems) - MAX_LISTED} more")
    if whole:
        lines.append(f"{whole} of {total} episodes can be used as they are: `skip_broken: true`")
    if without_images > whole:
        lines.append(f"{without_images} of {total} without their images: `without_images: true`")
    if whole or without_images:
        lines.append("(in the `store` block of a config, or as `--store.skip_broken true` after `--store.root FOLDER`)")
    return "\n".join(lines)


def _episode(table: pa.Table, row: Row, keys: Sequence[str], fps: float, shortest: int) -> tuple[dict[str, Array], str]:
    """The columns of one episode, or a message about what is wrong with them."""
    if len(table) != row.length:
        return {}, f"{len(table)} frames, where its metadata says {row.length}"
    if row.length < shortest:
        return {}, f"{row.length} frames are too few: an action needs the observation before it and the one after"
    index = np.asarray(table["index"])
    jumps = np.flatnonzero(index != row.begin + np.arange(row.length))
    if len(jumps):
        return {}, f"frame {jumps[0]} has the index {index[jumps[0]]}, where {row.begin + jumps[0]} is next"
    if (np.asarray(table["frame_index"]) != np.arange(row.length)).any():
        return {}, "its frame_index does not count 0, 1, 2, ..."
    late = np.abs(np.asarray(table["timestamp"]) - np.arange(row.length) / fps)
    if not (late < 0.5 / fps).all():
        return {}, f"frame {int(np.argmin(late < 0.5 / fps))} is not at the time that {fps:g} frames a second make it"
    columns = {}
    for key in keys:
        try:
            columns[key] = matrix(table[key])
        except StoreError as error:
            return {}, f"{key} {error}"
        wrong = np.argwhere(~np.isfinite(columns[key]))
        if len(wrong):
            frame, dimension = wrong[0]
            return (
                {},
                f"{key} is not finite at frame {frame}: dimension {dimension} is {columns[key][frame, dimension]}",
            )
    return columns, ""


def matrix(column: pa.ChunkedArray) -> Array:
    """(length, n) float32: a column of numbers or of lists of numbers."""
    whole = column.combine_chunks()
    if whole.null_count:
        raise StoreError("is empty at some frame")
    lists = (
        pa.types.is_list(whole.type) or pa.types.is_fixed_size_list(whole.type) or pa.types.is_large_list(whole.type)
    )
    flat = whole.flatten() if lists else whole
    if flat.null_count or len(flat) % max(len(whole), 1):
        raise StoreError("has not as many numbers at each frame")
    values = np.asarray(flat.to_numpy(zero_copy_only=False), np.float32)
    return values.reshape(len(whole), -1)


def _numbers(rows: Iterable[Row]) -> frozenset[int]:
    return frozenset(row.index for row in rows)


def _episodes(rows: Sequence[Row]) -> str:
    first, last = rows[0].index, rows[-1].index
    return f"episode {first}" if first == last else f"episodes {first} to {last}, {len(rows)} of them"
