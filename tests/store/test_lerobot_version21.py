"""LeRobot datasets in the layout of v2.1 read as those of v3.0 do, and as LeRobot's own conversion of them reads."""

import json
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from playlearn.errors import MissingStoreError, StoreError
from playlearn.store import LeRobotStoreConfig, NativeStore, open_store
from playlearn.store.base import Store
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot.reader import LeRobotStore
from playlearn.store.lerobot.recordings import LeRobotRecordings
from tests.lerobot_dataset import as_version21, change_info, encoded, image, vector, write_dataset

LENGTHS, N, FPS = (12, 9), 21, 20
STATE, TOP, SIDE = "observation.state", "observation.images.top", "observation.images.side"
FRAMES = np.random.default_rng(0).integers(0, 255, (N, 8, 10, 3)).astype(np.uint8)
TASKS = [["pick the cup"] * LENGTHS[0], ["\u00fcben"] * LENGTHS[1]]
KEYS = (STATE, "action", "observation.images.top", "time", "intervention", "skill")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same numbers, images and tasks in both layouts."""
    root = tmp_path_factory.mktemp("datasets")
    rows = np.random.default_rng(0).normal(size=(N, 3))
    known = {STATE: vector(["x", "y", "gripper"]), "action": vector(["dx", "dy", "gripper"]), TOP: image(8, 10, 3)}
    flag = {"dtype": "bool", "shape": [1], "names": None}
    columns = {STATE: rows.tolist(), "action": rows.tolist(), TOP: encoded(FRAMES)}
    columns |= {"intervention": np.arange(N) % 3 == 0, "next.success": np.arange(N) == 20}
    now = write_dataset(root / "v30", known | {"intervention": flag, "next.success": flag}, columns, LENGTHS, TASKS)
    return now, as_version21(now, root / "v21")


@pytest.fixture
def copy(made: tuple[Path, Path], tmp_path: Path) -> Path:
    return as_version21(made[0], tmp_path / "copy")


def opened(root: Path, **settings: bool) -> LeRobotStore:
    return LeRobotStoreConfig(root=root, cache=root.parent / f"frames of {root.name}", **settings).build()


def same(one: Store, other: Store) -> None:
    assert one.spec == other.spec
    assert one.indices().tolist() == other.indices().tolist()
    for i in range(len(one)):
        assert one.meta(i) == other.meta(i)
        for key in KEYS:
            assert np.array_equal(one.array(i, key), other.array(i, key)), key


def test_it_reads_as_a_dataset_of_version_3_does(made: tuple[Path, Path]) -> None:
    now, before = map(opened, made)
    same(before, now)
    assert before.meta(1).success is True
    assert before.meta(1).task == "\u00fcben"
    assert before.info()["version"] == "2.1"
    assert now.info()["version"] == "3.0"
    assert (before.array(1, TOP) == FRAMES[12:]).all()


def test_it_is_opened_by_its_folder_by_name_and_imported(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HF_LEROBOT_HOME", str(made[1].parent.parent))
    by_name = LeRobotStoreConfig(repo_id=f"{made[1].parent.name}/v21").build()
    assert len(by_name) == len(open_store(made[1])) == 2
    import_recordings(LeRobotRecordings(by_name), tmp_path / "native")
    assert (NativeStore.open(tmp_path / "native").array(1, TOP) == FRAMES[12:]).all()


def test_without_tags_the_hub_gives_the_main_branch(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dataset of 2.1 has no tag `v3.0`."""
    import huggingface_hub
    import requests
    from huggingface_hub.errors import RevisionNotFoundError

    def download(name: str, *, revision: str = "main", **_: object) -> str:
        if revision == "v3.0":
            raise RevisionNotFoundError("404", response=requests.Response())
        return str(made[1])

    monkeypatch.setattr(huggingface_hub, "snapshot_download", download)
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))
    assert len(LeRobotStoreConfig(repo_id="someone/v21", cache=tmp_path).build()) == 2


@pytest.mark.slow
def test_videos_read_as_in_lerobots_own_conversion(made: tuple[Path, Path], tmp_path: Path) -> None:
    """LeRobot's converter writes what it reads into another folder; its last step, which swaps the two, is left out."""
    import av
    from lerobot.scripts import convert_dataset_v21_to_v30 as converter

    before, after = as_version21(made[0], tmp_path / "before"), tmp_path / "after"
    info = json.loads((before / "meta/info.json").read_text())
    video = {"dtype": "video", "shape": [64, 64, 3], "names": ["height", "width", "channels"]}
    change_info(before, features=info["features"] | {SIDE: video}, total_videos=2)
    for k, length in enumerate(LENGTHS):
        path = before / f"videos/chunk-000/{SIDE}/episode_{k:06d}.mp4"
        path.parent.mkdir(parents=True, exist_ok=True)
        with closing(av.open(str(path), "w")) as container:
            stream = container.add_stream("h264", rate=FPS)
            stream.width = stream.height = 64
            stream.pix_fmt = "yuv420p"
            for t in range(length):
                shade = np.full((64, 64, 3), 100 * k + 8 * t, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(shade, format="rgb24")))
            container.mux(stream.encode())
    converter.convert_info(before, after, 100, 200)
    converter.convert_tasks(before, after)
    data, videos = converter.convert_data(before, after, 100), converter.convert_videos(before, after, 200)
    converter.convert_episodes_metadata(before, after, data, videos)
    one, other = opened(before), opened(after)
    same(one, other)
    for i in range(2):
        frames = one.array(i, SIDE)
        assert np.array_equal(frames, other.array(i, SIDE))
        assert np.abs(frames.mean(axis=(1, 2, 3)) - (100 * i + 8 * np.arange(LENGTHS[i]))).max() < 3


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no episodes": (lambda root: (root / "meta/episodes.jsonl").unlink(), "episodes.jsonl is missing: fetch it again"),
    "no tasks": (lambda root: (root / "meta/tasks.jsonl").unlink(), "tasks.jsonl is missing: fetch it again"),
    "a cut line": (
        lambda root: (root / "meta/episodes.jsonl").write_text('{"episode_index": 0, "length": 12}\n{"epis'),
        r"episodes.jsonl, line 2, cannot be read .*fetch it again",
    ),
    "no length": (
        lambda root: (root / "meta/episodes.jsonl").write_text('{"episode_index": 0, "length": "12"}'),
        r"episodes.jsonl, line 1, cannot be read \(episode_index 0, length '12'\)",
    ),
    "two texts": (
        lambda root: add_line(root / "meta/tasks.jsonl", '{"task_index": 0, "task": "other"}'),
        "tasks.jsonl has two texts for task_index 0",
    ),
    "a task without text": (
        lambda root: (root / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "play"}'),
        "episode 1: task_index is 1 at some frame, and meta/tasks.jsonl has no such task",
    ),
    "no data": (
        lambda root: (root / "data/chunk-000/episode_000001.parquet").unlink(),
        r"episode_000001.parquet is missing.*\(episode 1\)(.|\n)*1 of 2 episodes can be used",
    ),
    "no video": (
        lambda root: change_info(
            root, features=info_of(root)["features"] | {SIDE: image(8, 10, 3) | {"dtype": "video"}}
        ),
        f"videos/chunk-000/{SIDE}/episode_000000.mp4 is missing",
    ),
    "way out": (lambda root: change_info(root, data_path="../{episode_index}"), "leads out of the dataset: refused"),
    "attribute": (lambda root: change_info(root, data_path="{episode_chunk.real}"), "asks for episode_chunk.real"),
    "chunks of none": (lambda root: change_info(root, chunks_size=-0.5), "info.json cannot be read"),
    "version 2.0": (
        lambda root: change_info(root, codebase_version="v2.0"),
        r"2.1 and 3.0 are read here. Convert it .*0.3.3`, [^`]*: `python -m [a-z.]*v21.convert_dataset_v20_to_v21 ",
    ),
    "version 1.6": (
        lambda root: change_info(root, codebase_version="v1.6"),
        "v2.convert_dataset_v1_to_v2 --repo-id=.*, then `python -m lerobot.datasets.v21.convert_dataset_v20_to_v21",
    ),
}


def add_line(path: Path, line: str) -> None:
    path.write_text(f"{path.read_text()}{line}\n")


def info_of(root: Path) -> dict[str, dict[str, object]]:
    return dict(json.loads((root / "meta/info.json").read_text()))


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_named(copy: Path, name: str) -> None:
    damage, message = BROKEN[name]
    damage(copy)
    with pytest.raises(StoreError, match=message):
        opened(copy)


def test_intact_episodes_can_be_used(copy: Path) -> None:
    (copy / "data/chunk-000/episode_000000.parquet").unlink()
    assert opened(copy, skip_broken=True).indices().tolist() == [1]


def test_episodes_lie_in_chunks(copy: Path) -> None:
    change_info(copy, chunks_size=1)
    with pytest.raises(StoreError, match=r"chunk-001/episode_000001.parquet is missing"):
        opened(copy)
    (copy / "data/chunk-001").mkdir()
    (copy / "data/chunk-000/episode_000001.parquet").rename(copy / "data/chunk-001/episode_000001.parquet")
    assert len(opened(copy)) == 2


def test_no_folder_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(MissingStoreError):
        opened(tmp_path)
