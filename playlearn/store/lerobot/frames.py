"""Decode the images of an episode, from a video or from the images in its parquet file."""

import io
from collections.abc import Iterator, Mapping
from contextlib import closing
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
from av.error import FFmpegError
from PIL import Image, UnidentifiedImageError

from playlearn.episode import Array
from playlearn.errors import StoreError
from playlearn.picture import resized
from playlearn.store.lerobot.features import Camera, Size
from playlearn.store.lerobot.files import INFO, UNREADABLE, Clip, Row, first_line
from playlearn.store.lerobot.metadata import DatasetMetadata

MODES = ("RGB", "RGBA", "L", "LA", "P")  # of Pillow: 8 bits a color


def decode_episode(metadata: DatasetMetadata, row: Row, sizes: Mapping[str, Size]) -> dict[str, Array]:
    """Camera -> (length, h, w, 3) uint8 of one episode, scaled to `sizes`.

    Raises:
        StoreError: a file is missing or broken, or ends before the episode does; an image is not of the stated size.
    """
    videos = {name: metadata.cameras[name] for name in sizes if metadata.cameras[name].video}
    stored_images = {name: metadata.cameras[name] for name in sizes if name not in videos}
    frames = {name: _decode_video(metadata.root, row, row.clips[name], metadata.fps, sizes[name]) for name in videos}
    return frames | (_decode_images(metadata.root, row, stored_images, sizes) if stored_images else {})


def check_size(camera: Camera, found: Size, size: Size, where: Path | str) -> None:
    """Raise StoreError where an image is not of the camera's own size, unless every image is scaled to another one."""
    if found != camera.size == size:
        raise StoreError(
            f"{where}: {camera.key} is {found[0]}x{found[1]}, where {INFO} says {size[0]}x{size[1]}: set "
            "`image_size` to scale every image to one size"
        )


def probe_video(path: Path) -> tuple[float, Size]:
    """Length of a video in seconds, and (height, width); raises StoreError if it is not a video, or is cut short."""
    try:
        _check_end(path)
        with closing(av.open(str(path))) as container:
            stream = container.streams.video[0]
            size = stream.codec_context.height, stream.codec_context.width
            if stream.duration is None or stream.time_base is None:
                return float(Fraction(container.duration or 0, av.time_base)), size
            return float(stream.duration * stream.time_base), size
    except (*UNREADABLE, FFmpegError) as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error


def _check_end(path: Path) -> None:
    """Raise StoreError if a box of an MP4 ends beyond the file: an index at the front lists frames that are missing."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            head = file.read(16)
            if at == 0 and head[4:8] != b"ftyp":
                return  # another container: only the decoder can tell
            stated = int.from_bytes(head[:4])
            length = {0: size - at, 1: int.from_bytes(head[8:16])}.get(
                stated, stated
            )  # 0: to the end, 1: it needs 64 bits
            if length < 8 or at + length > size:
                raise StoreError(f"{path} is cut short at {size} bytes: fetch it again")
            at += length


def _decode_video(root: Path, row: Row, clip: Clip, fps: float, size: Size) -> Array:
    frames = np.empty((row.length, *size, 3), np.uint8)
    seen = np.zeros(row.length, np.bool_)
    path = root / clip.file
    try:
        with closing(av.open(str(path))) as container:
            stream = container.streams.video[0]
            base = stream.time_base
            if base is None:
                raise ValueError("it has no time base")
            stream.thread_type = "AUTO"
            # The key frame at or before the first one; half a step early, for what rounding may have done.
            container.seek(max(0, int((clip.begin - 0.5 / fps) / base)), stream=stream)
            for frame in container.decode(stream):
                at = round((float(frame.pts * base) - clip.begin) * fps)
                if at >= row.length:
                    break
                if at >= 0:
                    frames[at] = frame.to_ndarray(format="rgb24", height=size[0], width=size[1])
                    seen[at] = True
    except (*UNREADABLE, FFmpegError) as error:
        raise StoreError(f"{path} cannot be read ({first_line(error)}): fetch it again") from error
    if not seen.all():
        raise StoreError(f"{path} has no frame {int(np.argmin(seen))} of the {row.length} of episode {row.index}")
    return frames


def _decode_images(root: Path, row: Row, cameras: Mapping[str, Camera], sizes: Mapping[str, Size]) -> dict[str, Array]:
    made: dict[str, Array] = {name: np.empty((row.length, *sizes[name], 3), np.uint8) for name in cameras}
    path = root / row.data
    try:
        with pq.ParquetFile(path) as file:
            for name, camera in cameras.items():
                for at, cell in enumerate(_cells(file, row, camera.key)):
                    where = f"{path}: episode {row.index}, frame {at}"
                    made[name][at] = _decode_image(cell, camera, sizes[name], where)
    except UNREADABLE as error:
        keys = ", ".join(camera.key for camera in cameras.values())
        raise StoreError(f"{path}: {keys} of episode {row.index} cannot be read ({first_line(error)})") from error
    return made


def _decode_image(cell: Mapping[str, bytes | None], camera: Camera, size: Size, where: str) -> Array:
    """One frame (h, w, 3) uint8; raises StoreError where it is no color image."""
    try:
        with Image.open(io.BytesIO(cell["bytes"] or b"")) as picture:
            if picture.mode not in MODES:
                raise StoreError(f"{where}: {camera.key} is an image of mode {picture.mode}, and color images are read")
            check_size(camera, picture.size[::-1], size, where)
            return resized(np.asarray(picture.convert("RGB")), size)
    except UnidentifiedImageError as error:
        raise StoreError(f"{where}: {camera.key} holds no image: fetch it again") from error


def _cells(file: pq.ParquetFile, row: Row, key: str) -> Iterator[Mapping[str, bytes | None]]:
    """The episode's cells of one column: LeRobot writes a row group an episode, others may not."""
    for group in range(file.num_row_groups):
        owners = _owners(file, group)
        if owners is None or owners[0] <= row.index <= owners[1]:
            table = file.read_row_group(group, columns=[key, "episode_index"])
            mine = table.filter(np.asarray(table["episode_index"]) == row.index)
            yield from mine[key].to_pylist()


def _owners(file: pq.ParquetFile, group: int) -> tuple[int, int] | None:
    """The first and last episode in a row group, where the file says so."""
    column = file.schema_arrow.names.index("episode_index")
    for k in range(file.metadata.num_columns):
        part = file.metadata.row_group(group).column(k)
        if part.path_in_schema == file.schema_arrow.names[column]:
            statistics = part.statistics
            has_range = statistics is not None and statistics.has_min_max
            return (statistics.min, statistics.max) if has_range else None
    return None
