"""What is missing or broken in a LeRobot dataset, problem by problem, and which episodes can be used."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from playlearn.episode import Array
from playlearn.errors import StoreError
from playlearn.store.lerobot.features import Size, vector_size
from playlearn.store.lerobot.files import INFO, Row, column_types, read_parquet
from playlearn.store.lerobot.metadata import DatasetMetadata

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
    sizes = {key: vector_size(key, metadata.features[key]) for key in keys}
    for place, rows in _by_file(metadata.rows):
        try:
            table = read_parquet(metadata.root / place, [*keys, *NUMBERS])
            lacks = [key for key in (*keys, *NUMBERS) if key not in table.column_names]
            if lacks:
                raise StoreError(f"{metadata.root / place} has no {', '.join(lacks)}: fetch it again")
            for key in (*keys, *NUMBERS):
                check_type(metadata.root / place, table, key, sizes.get(key, 0))
        except StoreError as error:
            problems.append(Problem(f"{error} ({_episodes(rows)})", _numbers(rows)))
            continue
        owner = np.asarray(table["episode_index"])
        for row in rows:
            mine = np.flatnonzero(owner == row.index)
            own = table.slice(mine[0], mine[-1] - mine[0] + 1) if len(mine) else table.slice(0, 0)
            columns, message = _episode(own, row, sizes, metadata.fps, shortest)
            if message:
                problems.append(Problem(f"episode {row.index}: {message}", _numbers([row])))
            else:
                found[row.index] = columns
    return found, problems


def check_tasks(metadata: DatasetMetadata, columns: Mapping[int, Mapping[str, Array]], key: str) -> list[Problem]:
    """Find task indices, in the column `key`, that have no text."""
    problems = []
    for index, own in columns.items():
        unknown = set(own[key][:, 0].tolist()) - metadata.tasks.keys()
        if unknown:
            message = (
                f"episode {index}: {key} is {min(unknown):g} at some frame, and {metadata.tasks_file} has no such task"
            )
            problems.append(Problem(message, frozenset({index})))
    return problems


def check_cameras(metadata: DatasetMetadata, sizes: Mapping[str, Size]) -> list[Problem]:
    """Find images that are missing or broken, end before an episode does, or are not of the stated size.

    sizes: camera -> the (height, width) that it is scaled to.
    """
    problems = _check_videos(metadata, {name: size for name, size in sizes.items() if metadata.cameras[name].video})
    for place, rows in _by_file(metadata.rows):
        types = column_types(metadata.root / place)
        for camera in (metadata.cameras[name] for name in sizes):
            kind = types.get(camera.key)
            if not camera.video and (kind is None or not pa.types.is_struct(kind)):
                what = "has no" if kind is None else f"has {kind}, not encoded images, as"
                problems.append(Problem(f"{place} {what} {camera.key}: fetch it again", _numbers(rows), images=True))
    return problems


def _check_videos(metadata: DatasetMetadata, sizes: Mapping[str, Size]) -> list[Problem]:
    from playlearn.store.lerobot.frames import check_size, probe_video

    owners: dict[tuple[str, str], list[Row]] = {}
    problems = []
    for row in metadata.rows:
        for camera in sizes:
            if camera in row.clips:
                owners.setdefault((camera, row.clips[camera].file), []).append(row)
            else:
                problems.append(Problem(f"episode {row.index} has no video of {camera}", _numbers([row]), images=True))
    for (name, place), rows in owners.items():
        try:
            if not (metadata.root / place).is_file():
                raise StoreError(f"{metadata.root / place} is missing: fetch it again")
            length, size = probe_video(metadata.root / place)
            check_size(metadata.cameras[name], size, sizes[name], metadata.root / place)
        except StoreError as error:
            problems.append(Problem(f"{error} ({_episodes(rows)})", _numbers(rows), images=True))
            continue
        for row in rows:
            end = row.clips[name].begin + row.length / metadata.fps
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
        lines.append(f"what these allow: `playlearn info {root} --without-images`")
    if whole or without_images:
        lines.append("(in the `store` block of a config, or as `--store.skip_broken true` after `--store.root FOLDER`)")
    return "\n".join(lines)


def _episode(
    table: pa.Table, row: Row, sizes: Mapping[str, int], fps: float, shortest: int
) -> tuple[dict[str, Array], str]:
    """The columns of one episode, or a message about what is wrong with them. sizes: key -> numbers a frame."""
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
    for key, size in sizes.items():
        try:
            columns[key] = matrix(table[key])
        except StoreError as error:
            return {}, f"{key} {error} in {row.data}"
        if columns[key].shape[1] != size:
            return {}, f"{key} has {columns[key].shape[1]} numbers a frame, where {INFO} says {size}"
        wrong = np.argwhere(~np.isfinite(columns[key]))
        if len(wrong):
            frame, dimension = wrong[0]
            value = columns[key][frame, dimension]
            return {}, f"{key} is not finite at frame {frame}: dimension {dimension} is {value}"
    return columns, ""


def matrix(column: pa.ChunkedArray) -> Array:
    """(length, n) float32 of a column that passed `check_type`; raises StoreError where numbers are missing."""
    whole = column.combine_chunks()
    if whole.null_count:
        raise StoreError(f"is empty at frame {int(np.argmax(whole.is_null()))}")
    lists = _is_list(whole.type)
    flat = whole.flatten() if lists else whole
    sizes = np.asarray(pc.list_value_length(whole)) if lists else np.ones(len(whole), np.int64)
    if (sizes != sizes[:1]).any():
        raise StoreError(f"has {sizes[0]} numbers at frame 0 and others at frame {int(np.argmax(sizes != sizes[0]))}")
    if flat.null_count:
        raise StoreError(f"is empty at frame {int(np.argmax(flat.is_null())) // sizes[0]}")
    with np.errstate(over="ignore"):  # beyond float32 it is infinite, which is refused
        values = np.asarray(flat.to_numpy(zero_copy_only=False), np.float32)
    return values.reshape(len(whole), -1)


def check_type(path: Path, table: pa.Table, key: str, size: int) -> None:
    """Raise StoreError unless a column holds numbers or, where `size` is not 0, lists of that many at first."""
    kind, first = table[key].type, next((own for own in table[key] if own.is_valid), None)
    if not _of_numbers(kind.value_type if size and _is_list(kind) else kind):
        raise StoreError(f"{path}: {key} is of {kind}, not of numbers{' or lists of them' if size else ''}")
    found = len(first) if _is_list(kind) and first is not None else 1
    if size and first is not None and found != size:
        raise StoreError(f"{path}: {key} has {found} numbers at a frame, where {INFO} says {size}")


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind))


def _of_numbers(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def _by_file(rows: Iterable[Row]) -> list[tuple[str, list[Row]]]:
    """The episodes of each file of numbers."""
    ordered = sorted(rows, key=lambda row: (row.data, row.index))
    return [(place, list(group)) for place, group in groupby(ordered, lambda row: row.data)]


def _numbers(rows: Iterable[Row]) -> frozenset[int]:
    return frozenset(row.index for row in rows)


def _episodes(rows: Sequence[Row]) -> str:
    first, last = rows[0].index, rows[-1].index
    return f"episode {first}" if first == last else f"episodes {first} to {last}, {len(rows)} of them"
