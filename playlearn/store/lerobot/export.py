"""A LeRobot v3.0 dataset, built beside its destination, read back whole, and only then put there."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from playlearn.config import built_beside, disk_errors, disk_problem
from playlearn.episode import IMAGES, Array
from playlearn.errors import StoreError
from playlearn.store.base import Store
from playlearn.store.lerobot import sidecar, subtasks
from playlearn.store.lerobot.check import read_columns
from playlearn.store.lerobot.content import Content, Entry, Play, robot
from playlearn.store.lerobot.frames import decode_episode
from playlearn.store.lerobot.metadata import DatasetMetadata, is_lerobot, load_metadata

type Codec = Literal["av1", "h264"]
type ProgressCallback = Callable[[int, int], None]  # (episodes done, total)

ENCODERS = {"av1": "libsvtav1", "h264": "h264"}
MIN_PSNR = 20.0  # dB: an episode whose compressed images are worse counts as broken


@dataclass(frozen=True)
class Fidelity:
    """PSNR of a camera's images as they read back, in dB; infinite if they are equal.

    mean: of the mean squared error over all frames.
    worst: of the worst episode.
    """

    mean: float
    worst: float

    def __str__(self) -> str:
        exact = "every pixel as it was"
        return (
            exact
            if self.worst == float("inf")
            else f"PSNR {self.mean:.1f} dB, {self.worst:.1f} dB in the worst episode"
        )


def export_lerobot(
    store: Store, out: Path | str, *, videos: Codec | None = None, progress: ProgressCallback | None = None
) -> dict[str, Fidelity]:
    """Write the store as it is; see `write_lerobot`."""
    return write_lerobot(Play(store), out, videos=videos, progress=progress)


def write_lerobot(
    content: Content,
    out: Path | str,
    *,
    videos: Codec | None = None,
    progress: ProgressCallback | None = None,
    write_extras: Callable[[Path, Mapping[str, Fidelity]], None] = lambda _root, _fidelity: None,
) -> dict[str, Fidelity]:
    """Write a LeRobot dataset to `out` and return how each camera reads back.

    videos: codec of MP4 files (smaller, lossy, slower to read); null: images.
    write_extras: puts further files into the folder of the finished dataset before it appears at `out`.

    Raises:
        StoreError: `out` is taken, there is nothing to write, its fps is no whole number, or what is read back is not
            what was written.
        BusyError: another process exports to `out`.
        DiskError: the disk is full or cannot be written; nothing is left there.
    """
    out = Path(out)
    with built_beside(out) as building:
        _check(content, out)
        with _quiet(), _logged_errors(), disk_errors(out.parent):
            _write(content, building, f"local/{out.name}", videos, progress)
            fidelity = _read_back(content, building, f"local/{out.name}", videos)
        write_extras(building, fidelity)
    return fidelity


def _check(content: Content, out: Path) -> None:
    if is_lerobot(out):
        raise StoreError(f"{out} already exists, a LeRobot dataset; remove it, or name another folder")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StoreError(f"{out} already exists: name another folder")
    if len(content) == 0:
        raise StoreError(f"{content.store.name()} holds no episodes: there is nothing to export")
    if content.store.spec.fps != round(content.store.spec.fps):
        raise StoreError(
            f"{content.store.name()} runs at {content.store.spec.fps} steps a second; LeRobot takes whole numbers only"
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence LeRobot: encoder banners, a progress bar for each episode, and warnings about the codec."""
    import av

    import datasets

    logger = logging.getLogger("lerobot")
    level, bars, banners = logger.level, not datasets.are_progress_bars_disabled(), os.environ.get("SVT_LOG")
    logger.setLevel(logging.ERROR)
    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()
    os.environ["SVT_LOG"] = banners or "1"  # 1: errors only
    try:
        yield
    finally:
        logger.setLevel(level)
        av.logging.set_libav_level(av.logging.INFO)
        if bars:
            datasets.enable_progress_bars()
        if banners is None:
            del os.environ["SVT_LOG"]


@contextmanager
def _logged_errors() -> Iterator[None]:
    """Raise what LeRobot's threads only log: an image that cannot be written is then missed somewhere else."""
    logged: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: logged.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("lerobot")
    logger.addHandler(handler)
    propagate, logger.propagate = logger.propagate, False  # one line, not one an image
    try:
        yield
    except Exception as error:
        if logged:
            raise _logged_error(logged[0]) from error
        raise
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    if logged:
        raise _logged_error(logged[0])


def _logged_error(message: str) -> Exception:
    error = OSError(message)
    return error if disk_problem(error) else StoreError(f"LeRobot cannot write the dataset: {message}")


def _write(content: Content, root: Path, name: str, videos: Codec | None, progress: ProgressCallback | None) -> None:
    # Imported here because it takes seconds, and every command imports the store.
    from lerobot.configs import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = content.features()
    cameras = [key for key, feature in features.items() if feature["dtype"] == "image"]
    if videos:
        features |= {key: {**features[key], "dtype": "video"} for key in cameras}
    dataset = LeRobotDataset.create(
        repo_id=name,
        fps=round(content.store.spec.fps),
        features=features,
        root=root,
        robot_type=robot(content.store.spec),
        use_videos=videos is not None,
        image_writer_threads=0 if videos else 2 * len(cameras),
        streaming_encoding=videos is not None,
        # The queue drops frames if the encoder falls behind, so it must be large enough for all.
        encoder_queue_maxsize=1 << 20,
        rgb_encoder=RGBEncoderConfig(vcodec=ENCODERS[videos]) if videos else None,
    )
    annotations: dict[int, tuple[tuple[int, str], ...]] = {}
    try:
        for i in range(len(content)):
            entry = content.entry(i)
            for frame in _frames(entry):
                dataset.add_frame(frame)
            dataset.save_episode()
            annotations[i] = entry.subtasks
            if entry.sidecar is not None:
                sidecar.write(root, i, *entry.sidecar)
            if progress:
                progress(i + 1, len(content))
    finally:
        dataset.finalize()
    if any(annotations.values()):
        subtasks.annotate(root, annotations, content.store.spec.fps)


def _frames(entry: Entry) -> Iterator[dict[str, Any]]:
    """As `LeRobotDataset.add_frame` wants them."""
    for t in range(len(entry)):
        yield {"task": entry.tasks[t], **{key: column[t] for key, column in entry.columns.items()}}


def _read_back(content: Content, root: Path, name: str, videos: Codec | None) -> dict[str, Fidelity]:
    """Compare every number and every image; raises StoreError if something else is read than was written."""
    metadata = load_metadata(root)
    keys = [key for key, feature in content.features().items() if feature["dtype"] != "image"]
    columns, problems = read_columns(metadata, keys, 1)
    _require(not problems, "; ".join(problem.message for problem in problems[:3]))
    total = len(metadata.rows), sum(row.length for row in metadata.rows)
    _require(total[0] == len(content), f"{total[0]} episodes, where {len(content)} were written")
    _require(total == (metadata.episodes, metadata.frames), f"counts in meta/info.json that are not {total}")
    errors: dict[str, list[tuple[float, int]]] = {camera: [] for camera in metadata.cameras}
    for row in metadata.rows:
        entry = content.entry(row.index)
        _require(
            row.length == len(entry), f"{row.length} frames of episode {row.index}, where {len(entry)} were written"
        )
        for key in keys:
            same = np.array_equal(columns[row.index][key], entry.columns[key])
            _require(same, f"episode {row.index} with another {key}")
        sizes = {camera: metadata.cameras[camera].size for camera in errors}
        for camera, images in decode_episode(metadata, row, sizes).items():
            error = _squared_error(images, entry.columns[IMAGES + camera])
            _require(videos is not None or error == 0, f"episode {row.index} with other images of {camera}")
            _require(
                _psnr(error) >= MIN_PSNR, f"episode {row.index} with a {camera} of {_psnr(error):.1f} dB PSNR only"
            )
            errors[camera].append((error, row.length))
    _check_with_lerobot(content, metadata, name)
    return {camera: _fidelity(own) for camera, own in errors.items()}


def _check_with_lerobot(content: Content, metadata: DatasetMetadata, name: str) -> None:
    """Check the first and the last frame with LeRobot's own reader: indices, time and task."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    last = len(content) - 1
    # Two episodes only: LeRobot copies what it opens into its cache.
    dataset = LeRobotDataset(name, root=metadata.root, episodes=sorted({0, last}), video_backend="pyav")
    for at, i, t in ((0, 0, 0), (-1, last, metadata.rows[last].length - 1)):
        read = dataset[at % len(dataset)]
        where = (
            int(read["episode_index"]),
            int(read["frame_index"]),
            round(float(read["timestamp"]) * content.store.spec.fps),
        )
        _require(where == (i, t, t), f"frame {where}, where {(i, t, t)} was written")
        task = content.entry(i).tasks[t]
        _require(read["task"] == task, f"episode {i}: task {read['task']!r}, not {task!r}")


def _fidelity(errors: Sequence[tuple[float, int]]) -> Fidelity:
    """errors: the mean squared error and the length of each episode."""
    values, lengths = zip(*errors, strict=True)
    return Fidelity(_psnr(float(np.average(values, weights=lengths))), _psnr(max(values)))


def _squared_error(one: Array, other: Array) -> float:
    """Mean squared error over an episode; 0 if everything is equal."""
    return float(np.square(one.astype(np.float32) - other).mean())


def _psnr(squared_error: float) -> float:
    return float("inf") if squared_error == 0 else float(10 * np.log10(255**2 / squared_error))


def _require(condition: bool, found: str) -> None:
    if not condition:
        raise StoreError(f"what was written reads back as {found}: it was discarded; please report this as a bug")
