"""A LeRobot v3.0 dataset, built beside its destination, read back whole, and only then put there."""

import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from playlearn.episode import IMAGES, Array
from playlearn.errors import StoreError
from playlearn.store.base import Store
from playlearn.store.lerobot import sidecar, subtasks
from playlearn.store.lerobot.check import numbers
from playlearn.store.lerobot.content import Content, Entry, Play, robot
from playlearn.store.lerobot.frames import decoded
from playlearn.store.lerobot.metadata import Description, describe, is_lerobot

type Codec = Literal["av1", "h264"]
type Said = Callable[[int, int], None]  # (episodes done, episodes in all)

ENCODERS = {"av1": "libsvtav1", "h264": "h264"}
POOREST = 20.0  # dB: what a video's compression may make of an episode's pictures before we call it broken


@dataclass(frozen=True)
class Fidelity:
    """How a camera's pictures read back, in dB; infinite where they are equal.

    mean: PSNR of the mean squared error over all frames. worst: of the worst episode.
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
    store: Store, out: Path | str, *, videos: Codec | None = None, progress: Said | None = None
) -> dict[str, Fidelity]:
    """Write the store as it is; see `write_lerobot`."""
    return write_lerobot(Play(store), out, videos=videos, progress=progress)


def write_lerobot(
    content: Content,
    out: Path | str,
    *,
    videos: Codec | None = None,
    progress: Said | None = None,
    beside: Callable[[Path, Mapping[str, Fidelity]], None] = lambda _root, _fidelity: None,
) -> dict[str, Fidelity]:
    """Write a LeRobot dataset to `out` and return how each camera reads back.

    videos: cameras as MP4 (smaller, lossy, slower to read) instead of images. beside: puts further files into the
    finished dataset's folder before anybody sees it.

    Raises:
        StoreError: `out` is taken, there is nothing to write, its fps is no whole number, the disk is full, or what
            is read back is not what was written.
    """
    out = Path(out)
    _check(content, out)
    building = out.with_name(f".{out.name}.building")
    shutil.rmtree(building, ignore_errors=True)  # of an export that was killed
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with _quiet():
            _write(content, building, f"local/{out.name}", videos, progress)
            fidelity = _read_back(content, building, f"local/{out.name}", videos)
        beside(building, fidelity)
        building.replace(out)
    except OSError as error:
        raise StoreError(f"{out} cannot be written ({error.strerror or error}): nothing was left there") from error
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return fidelity


def _check(content: Content, out: Path) -> None:
    if is_lerobot(out):
        raise StoreError(
            f"{out} is there already, a LeRobot dataset; remove it to write it anew, or name another folder"
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StoreError(f"{out} already exists: name another folder")
    if len(content) == 0:
        raise StoreError(f"{content.store.name()} holds no episodes: there is nothing to export")
    if content.store.spec.fps != round(content.store.spec.fps):
        raise StoreError(
            f"{content.store.name()} runs at {content.store.spec.fps} steps a second; LeRobot knows whole numbers only"
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """LeRobot without the encoder's banners, a bar an episode, and a page on the codec that it can do without."""
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


def _write(content: Content, root: Path, name: str, videos: Codec | None, progress: Said | None) -> None:
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
        # Its queue drops frames where the encoder falls behind: let it take whatever comes.
        encoder_queue_maxsize=1 << 20,
        rgb_encoder=RGBEncoderConfig(vcodec=ENCODERS[videos]) if videos else None,
    )
    spoken: dict[int, tuple[tuple[int, str], ...]] = {}
    try:
        for i in range(len(content)):
            entry = content.entry(i)
            for frame in _frames(entry):
                dataset.add_frame(frame)
            dataset.save_episode()
            spoken[i] = entry.subtasks
            if entry.sidecar is not None:
                sidecar.keep(root, i, *entry.sidecar)
            if progress:
                progress(i + 1, len(content))
    finally:
        dataset.finalize()
    if any(spoken.values()):
        subtasks.annotate(root, spoken, content.store.spec.fps)


def _frames(entry: Entry) -> Iterator[dict[str, Any]]:
    """As `LeRobotDataset.add_frame` wants them."""
    for t in range(len(entry)):
        yield {"task": entry.tasks[t], **{key: column[t] for key, column in entry.columns.items()}}


def _read_back(content: Content, root: Path, name: str, videos: Codec | None) -> dict[str, Fidelity]:
    """Compare every number and every picture; raises StoreError where another is read than was written."""
    described = describe(root)
    keys = [key for key, feature in content.features().items() if feature["dtype"] != "image"]
    columns, problems = numbers(described, keys, 1)
    _require(not problems, "; ".join(problem.words for problem in problems[:3]))
    total = len(described.rows), sum(row.length for row in described.rows)
    _require(total[0] == len(content), f"{total[0]} episodes, where {len(content)} were written")
    _require(total == (described.episodes, described.frames), f"counts in meta/info.json that are not {total}")
    errors: dict[str, list[tuple[float, int]]] = {camera: [] for camera in described.cameras}
    for row in described.rows:
        entry = content.entry(row.index)
        _require(
            row.length == len(entry), f"{row.length} frames of episode {row.index}, where {len(entry)} were written"
        )
        for key in keys:
            same = np.array_equal(columns[row.index][key], entry.columns[key])
            _require(same, f"episode {row.index} with another {key}")
        sizes = {camera: described.cameras[camera].size for camera in errors}
        for camera, pictures in decoded(described, row, sizes).items():
            error = _squared_error(pictures, entry.columns[IMAGES + camera])
            _require(videos is not None or error == 0, f"episode {row.index} with other images of {camera}")
            _require(_psnr(error) >= POOREST, f"episode {row.index} with a {camera} of {_psnr(error):.1f} dB PSNR only")
            errors[camera].append((error, row.length))
    _by_lerobot(content, described, name)
    return {camera: _fidelity(own) for camera, own in errors.items()}


def _by_lerobot(content: Content, described: Description, name: str) -> None:
    """The first and the last frame as LeRobot's own reader gives them: indices, time and task."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    last = len(content) - 1
    # Two episodes only: LeRobot copies what it opens into its cache.
    dataset = LeRobotDataset(name, root=described.root, episodes=sorted({0, last}), video_backend="pyav")
    for at, i, t in ((0, 0, 0), (-1, last, described.rows[last].length - 1)):
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
    """The mean over an episode; 0 where all is equal."""
    return float(np.square(one.astype(np.float32) - other).mean())


def _psnr(squared_error: float) -> float:
    return float("inf") if squared_error == 0 else float(10 * np.log10(255**2 / squared_error))


def _require(holds: bool, otherwise: str) -> None:
    if not holds:
        raise StoreError(f"what was written reads back as {otherwise}: it was thrown away; please report this as a bug")
