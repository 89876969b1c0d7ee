"""A LeRobot v3.0 dataset from a store: what `LeRobotDataset` reads and `lerobot-train` trains on.

    observation.state               (S,)        observation.images.<camera>   (h, w, 3)
    observation.environment_state   (G,)        achieved: objects and fixtures
    action                          (A,)        the label, `expert_action`
    task                            text        the episode's task; of play, the skill at that step in words

An episode of T actions becomes T frames: LeRobot has no place for the observation after the last action.
"""

import logging
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.episode import IMAGES, Array, Episode, read_annotation
from playlearn.errors import StoreError
from playlearn.store.base import Store

PLAY = "play"  # the task of a step that has neither a task nor a skill
LOSSY = 16.0  # mean difference, of 255, that a video's compression may make


def export_lerobot(
    store: Store,
    out: Path | str,
    *,
    videos: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the store to `out` as a LeRobot dataset; built beside it, read back, and only then put there.

    videos: cameras as MP4 (smaller, lossy, slower to read) instead of images. progress: called with
    (episodes done, episodes in all). Returns `out`.

    Raises:
        StoreError: `out` is taken, the store is empty or its fps is no whole number, the disk is full, or
            what LeRobot reads back is not what was written.
    """
    out = Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StoreError(f"{out} already exists: name another folder")
    if len(store) == 0:
        raise StoreError(f"{store.name()} holds no episodes: there is nothing to export")
    if store.spec.fps != round(store.spec.fps):
        raise StoreError(f"{store.name()} runs at {store.spec.fps} steps a second; LeRobot knows whole numbers only")
    building = out.with_name(f".{out.name}.building")
    shutil.rmtree(building, ignore_errors=True)  # of an export that was killed
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with _quiet():
            _write(store, building, f"local/{out.name}", videos, progress)
            _read_back(store, building, f"local/{out.name}", videos)
        building.replace(out)
    except OSError as error:
        raise StoreError(f"{out} cannot be written ({error.strerror or error}): nothing was left there") from error
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return out


def frames(episode: Episode) -> Iterator[dict[str, Any]]:
    """The episode's T frames as `LeRobotDataset.add_frame` wants them."""
    for t in range(len(episode)):
        yield {
            "observation.state": episode.state[t],
            "observation.environment_state": episode.achieved[t],
            "action": episode.expert_action[t],
            "task": _task(episode, t),
            **{IMAGES + camera: pictures[t] for camera, pictures in episode.images.items()},
        }


def features(store: Store, videos: bool) -> dict[str, dict[str, Any]]:
    """LeRobot's description of each column."""
    spec = store.spec
    vectors = {
        "observation.state": spec.state_names,
        "observation.environment_state": spec.achieved_names,
        "action": spec.action_names,
    }
    return {
        **{key: {"dtype": "float32", "shape": (len(names),), "names": list(names)} for key, names in vectors.items()},
        **{
            IMAGES + camera: {
                "dtype": "video" if videos else "image",
                "shape": (h, w, 3),
                "names": ["height", "width", "channels"],
            }
            for camera, (h, w) in store.cameras().items()
        },
    }


def _task(episode: Episode, t: int) -> str:
    skills = episode.meta.skills
    skill = read_annotation(skills[episode.skill[t]])[0] if skills else ""
    return episode.meta.task or skill.replace("_", " ") or PLAY


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


def _write(store: Store, root: Path, name: str, videos: bool, progress: Callable[[int, int], None] | None) -> None:
    # Imported here because it takes seconds, and every command imports the store.
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    environment = store.spec.environment
    dataset = LeRobotDataset.create(
        repo_id=name,
        fps=round(store.spec.fps),
        features=features(store, videos),
        root=root,
        robot_type=str(environment.get("robot", environment.get("type", "unknown"))),
        use_videos=videos,
        image_writer_threads=0 if videos else 2 * len(store.cameras()),
        streaming_encoding=videos,
    )
    try:
        for i in range(len(store)):
            for frame in frames(store.read(i)):
                dataset.add_frame(frame)
            dataset.save_episode()
            if progress:
                progress(i + 1, len(store))
    finally:
        dataset.finalize()


def _read_back(store: Store, root: Path, name: str, videos: bool) -> None:
    """Raises StoreError where LeRobot reads something other than what the store holds."""
    import pyarrow.parquet as pq
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    lengths = store.lengths()
    columns = pq.read_table(root / "data", columns=["timestamp"])
    expected = np.concatenate([np.arange(length) for length in lengths]) / store.spec.fps
    timestamps = columns["timestamp"].to_numpy()
    _require(len(timestamps) == len(expected), f"{len(timestamps)} frames, where {len(expected)} were written")
    _require(np.allclose(timestamps, expected, atol=1e-4), "other timestamps than were written")
    # Two episodes only: LeRobot copies what it opens into its cache.
    some = sorted({0, len(store) - 1})
    dataset = LeRobotDataset(name, root=root, episodes=some, video_backend="pyav")
    total = dataset.meta.total_episodes, dataset.meta.total_frames
    _require(total == (len(store), int(lengths.sum())), f"{total} episodes and frames in its metadata")
    start = 0
    for i in some:
        episode = store.read(i)
        written = list(frames(episode))
        for t in sorted({0, len(episode) // 2, len(episode) - 1}):
            _compare(written[t], dataset[start + t], f"episode {i}, frame {t}", videos)
        start += len(episode)


def _compare(written: dict[str, Any], read: dict[str, Any], where: str, videos: bool) -> None:
    _require(read["task"] == written["task"], f"{where}: task {read['task']!r}, not {written['task']!r}")
    for key, value in written.items():
        if key.startswith(IMAGES):
            picture = np.moveaxis(np.asarray(read[key]), 0, -1) * 255.0  # (3, h, w) in [0, 1] -> (h, w, 3)
            difference = float(np.abs(picture - value.astype(np.float64)).mean())
            _require(difference <= (LOSSY if videos else 0.5), f"{where}: {key} is off by {difference:.1f} of 255")
        elif key != "task":
            _require(_same(np.asarray(read[key]), value), f"{where}: another {key} than was written")


def _same(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool((one == other).all())


def _require(holds: bool, otherwise: str) -> None:
    if not holds:
        raise StoreError(f"LeRobot reads back {otherwise}: the export was thrown away; please report this as a bug")
