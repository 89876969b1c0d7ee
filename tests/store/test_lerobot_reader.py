"""A LeRobot dataset as a store: ours reads back equal, any other can be trained on, and broken parts are named."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from playlearn.config import from_dict
from playlearn.data import DataConfig, PlayDataset
from playlearn.errors import StoreError, UsageError
from playlearn.quantity import Quantities
from playlearn.relabeling import UniformConfig
from playlearn.store import LeRobotStoreConfig, NativeStore, Store, StoreConfig, open_store
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot import frames
from playlearn.store.lerobot.export import export_lerobot
from playlearn.store.lerobot.reader import LeRobotStore
from playlearn.store.lerobot.recordings import LeRobotRecordings
from tests.synthetic import QUANTITIES, make_store

pytestmark = pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix
CAMERAS = {"front": (16, 24), "wrist": (16, 16)}
STEPS, FPS = 30, 20
FRONT = "observation.images.front"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("reader") / "play", np.random.default_rng(0), 3, STEPS, CAMERAS)


@pytest.fixture(scope="module", params=[None, "h264"], ids=["images", "video"])
def exported(request: pytest.FixtureRequest, store: NativeStore, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / str(request.param)
    import datasets

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(datasets.config, "HF_DATASETS_CACHE", str(out.parent / "cache"))
        export_lerobot(store, out, videos=request.param)
    return out


@pytest.fixture
def copy(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "copy"))


@pytest.fixture
def without_sidecars(copy: Path) -> Path:
    """As LeRobot itself writes it: without sidecars."""
    shutil.rmtree(copy / "meta" / "playlearn")
    return copy


def opened(root: Path, **settings: Any) -> LeRobotStore:
    return LeRobotStoreConfig(root=root, cache=root.parent / "frames", **settings).build()


def same(one: Store, other: Store, *, but: str = "none") -> None:
    assert one.spec.state_names == other.spec.state_names
    assert one.indices().tolist() == other.indices().tolist()
    for i in range(len(one)):
        mine, its = one.read(i), other.read(i)
        assert mine.meta == its.meta
        for key, array in mine.arrays().items():
            assert its.arrays()[key].dtype == array.dtype
            assert its.arrays()[key].shape == array.shape
            if but not in key:
                np.testing.assert_array_equal(its.arrays()[key], array)


def test_an_export_reads_back_equal(store: NativeStore, exported: Path) -> None:
    back = opened(exported)
    same(store, back, but="none" if exported.name == "None" else "images")
    store.spec.check(back.spec)
    assert back.verify() == []
    assert back.info()["episodes"] == 3
    # The last observation is in the sidecar, not in a video.
    np.testing.assert_array_equal(back.read(1).images["front"][-1], store.read(1).images["front"][-1])


def test_a_dataset_without_sidecars_is_one_step_shorter(store: NativeStore, without_sidecars: Path) -> None:
    back = opened(without_sidecars)
    assert back.lengths().tolist() == [STEPS - 1] * 3  # the observation after the last action is missing
    mine, its = store.read(2), back.read(2)
    np.testing.assert_array_equal(its.state, mine.state[:-1])
    np.testing.assert_array_equal(its.achieved, mine.achieved[:-1])
    np.testing.assert_array_equal(its.action, mine.expert_action[:-1])
    np.testing.assert_array_equal(its.expert_action, its.action)
    np.testing.assert_allclose(its.time, np.arange(STEPS) / FPS)
    # Several tasks in an episode are read as its skills; a single one is its task.
    skills = [mine.meta.skills[skill] for skill in mine.skill[:-1]]
    assert [(its.meta.skills or (its.meta.task,))[skill] for skill in its.skill] == skills
    assert bool(its.meta.skills) == (len(set(skills)) > 1)
    assert its.meta.state_names == mine.meta.state_names
    # What numbers measure is the dataset's own.
    assert back.spec.quantities == its.meta.quantities == store.spec.quantities == QUANTITIES


@pytest.mark.parametrize(
    ("key", "entry", "message"),
    [
        ("observation.state", {"quantities": ["length x"]}, "quantities of observation.state must give each of its 4"),
        ("observation.state", {"quantities": ["meter"] * 4}, r"a kind \(length, direction"),
        (
            "action",
            {"bounds": [[-1, 1], None, [1, -1], None]},
            r"bounds of action must give each of its 4 numb",
        ),
        ("action", {"bounds": "yes"}, "bounds of action"),
        ("action", {"bounds": 3}, "bounds of action"),
        ("observation.state", {"quantities": 3}, "quantities of observation.state"),
    ],
)
def test_a_declaration_that_does_not_fit_is_refused(
    key: str, entry: dict[str, Any], message: str, without_sidecars: Path
) -> None:
    path = without_sidecars / "meta" / "info.json"
    info = json.loads(path.read_text())
    info["features"][key] |= entry
    path.write_text(json.dumps(info))
    with pytest.raises(StoreError, match=message):
        opened(without_sidecars)


def test_without_a_declaration_nothing_is_known(without_sidecars: Path) -> None:
    path = without_sidecars / "meta" / "info.json"
    info = json.loads(path.read_text())
    for feature in info["features"].values():
        feature.pop("quantities", None)
        feature.pop("bounds", None)
    path.write_text(json.dumps(info))
    assert opened(without_sidecars).spec.quantities == Quantities()


def test_a_dataset_trains_as_a_store_does(store: NativeStore, copy: Path) -> None:
    config = DataConfig(goals=UniformConfig(horizon=1.0), cameras=("front",), goal_cameras=("wrist",), val_fraction=0)
    mine, its = PlayDataset(store, config), PlayDataset(open_store(opened_config(copy)), config)
    one, other = mine.batch(1, np.arange(20)), its.batch(1, np.arange(20))
    for name in ("state", "achieved", "action", "goal_achieved", "steps_to_goal"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.goal_images["wrist"].shape == other.goal_images["wrist"].shape


def test_frames_are_decoded_once_and_cached(without_sidecars: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from playlearn.store.lerobot import reader

    decoded_rows: list[int] = []

    def counting(metadata: Any, row: Any, sizes: Any) -> Any:
        decoded_rows.append(row.index)
        return frames.decode_episode(metadata, row, sizes)

    monkeypatch.setattr(reader, "decode_episode", counting)
    one = opened(without_sidecars)
    first = np.array(one.array(1, "observation.images.front"))
    assert decoded_rows == [1]
    again = opened(without_sidecars)  # another process, after a kill
    np.testing.assert_array_equal(again.array(1, "observation.images.front"), first)
    again.array(2, "observation.images.wrist")
    assert decoded_rows == [1, 2]
    smaller = opened(without_sidecars, image_size=(8, 12))
    assert smaller.array(1, "observation.images.front").shape == (STEPS, 8, 12, 3)
    assert decoded_rows == [1, 2, 1]
    cached = next((without_sidecars.parent / "frames").rglob("000001.safetensors"))
    cached.write_bytes(cached.read_bytes()[:100])  # cut short, as by a full disk
    opened(without_sidecars, image_size=(8, 12)).array(1, "observation.images.front")
    assert decoded_rows == [1, 2, 1, 1]


def test_the_kind_of_a_store_is_found_from_its_folder(store: NativeStore, exported: Path) -> None:
    assert open_store(exported).info()["format"] == "lerobot"
    assert open_store(store.path).info()["format"] == "playlearn"
    assert isinstance(from_dict(StoreConfig, {"type": "lerobot", "root": "x"}), LeRobotStoreConfig)  # type: ignore[type-abstract]


def rewrite(path: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    pq.write_table(change(pq.read_table(path)), path)


def column(table: pa.Table, name: str, change: Callable[[np.ndarray], np.ndarray]) -> pa.Table:
    at = table.column_names.index(name)
    values = change(np.array(table[name].to_pylist()))
    return table.set_column(at, name, pa.array(values.tolist(), table[name].type))


def put(values: np.ndarray, at: int, value: Any) -> np.ndarray:
    values[at] = value
    return values


def info(root: Path, **changed: Any) -> None:
    path = root / "meta" / "info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))


DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
EVIL = "../../{video_key}/{chunk_index}{file_index}.mp4"
BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no dataset": (lambda root: (root / "meta/info.json").unlink(), r"there is no LeRobot dataset at .*copy"),
    "version 2.1": (
        lambda root: info(root, codebase_version="v2.1"),
        "in meta/info.json asks for chunk_index, file_index: refused",
    ),
    "a newer one": (
        lambda root: info(root, codebase_version="v4.0"),
        "version 4.0; versions 2.1 and 3.0 are read here: update",
    ),
    "no fps": (lambda root: info(root, fps=0), "fps must be above 0"),
    "broken info": (lambda root: (root / "meta/info.json").write_text("{"), "info.json cannot be read"),
    "a pickle": (lambda root: (root / "meta/stats.pkl").touch(), "is a pickle, which can run code"),
    "way out": (lambda root: info(root, data_path="../{chunk_index}{file_index}"), "leads out of the dataset: refused"),
    "absolute": (
        lambda root: info(root, data_path="/etc/{chunk_index}{file_index}"),
        "leads out of the dataset: refused",
    ),
    "attribute": (lambda root: info(root, data_path="{chunk_index.real}"), "asks for chunk_index.real: refused"),
    "no episodes": (
        lambda root: (root / EPISODES).unlink(),
        "says total_episodes 3, its episodes' metadata makes it 0",
    ),
    "cut metadata": (lambda root: cut(root / EPISODES), "file-000.parquet cannot be read .*fetch it again"),
    "cut data": (lambda root: cut(root / DATA), r"cannot be read .*\(episodes 0 to 2, 3 of them\)"),
    "no data": (lambda root: (root / DATA).unlink(), r"file-000.parquet is missing.*episodes 0 to 2"),
    "counts": (lambda root: info(root, total_frames=7), "says total_frames 7, its episodes' metadata makes it 90"),
    "fewer": (lambda root: info(root, total_episodes=5), "says total_episodes 5, its episodes' metadata makes it 3"),
    "not a number": (
        lambda root: rewrite(root / DATA, lambda t: column(t, "action", lambda a: put(a, 34, np.nan))),
        (
            "episode 1: action is not finite at frame 4: dimension 0 is nan(.|\n)*"
            "2 of 3 episodes can be used as they are: `skip_broken: true`"
        ),
    ),
    "index gap": (
        lambda root: rewrite(root / DATA, lambda t: column(t, "index", lambda a: a + (a > 65))),
        "episode 2: frame 6 has the index 67, where 66 is next",
    ),
    "late frame": (
        lambda root: rewrite(root / DATA, lambda t: column(t, "timestamp", lambda a: put(a, 33, 9.0))),
        "episode 1: frame 3 is not at the time that 20 frames a second make it",
    ),
    "lost frames": (
        lambda root: rewrite(root / DATA, lambda t: t.slice(0, 80)),
        "episode 2: 20 frames, where .* says 30",
    ),
    "no action": (lambda root: rewrite(root / DATA, lambda t: t.drop(["action"])), "file-000.parquet has no action"),
}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_named(without_sidecars: Path, name: str) -> None:
    damage, message = BROKEN[name]
    damage(without_sidecars)
    with pytest.raises(StoreError, match=message):
        opened(without_sidecars)


def test_intact_episodes_can_be_used(without_sidecars: Path, store: NativeStore) -> None:
    BROKEN["not a number"][0](without_sidecars)
    left = opened(without_sidecars, skip_broken=True)
    assert left.indices().tolist() == [0, 2]
    np.testing.assert_array_equal(left.array(1, "action"), store.array(2, "expert_action")[:-1])


@pytest.mark.parametrize("length", [0, 1])
def test_an_episode_of_no_or_one_frame_is_refused(without_sidecars: Path, length: int) -> None:
    def shorten(table: pa.Table) -> pa.Table:
        return pa.concat_tables([table.slice(0, 60), table.slice(60, length)])

    rewrite(without_sidecars / DATA, shorten)
    rewrite(without_sidecars / EPISODES, lambda t: column(t, "length", lambda a: put(a, 2, length)))
    info(without_sidecars, total_frames=60 + length)
    with pytest.raises(StoreError, match=rf"episode 2: {length} frames are too few(.|\n)*2 of 3 episodes can be used"):
        opened(without_sidecars)
    assert len(opened(without_sidecars, skip_broken=True)) == 2


def test_a_missing_sidecar_is_named(copy: Path) -> None:
    sidecars = copy / "meta" / "playlearn"
    (sidecars / "000001.safetensors").unlink()
    with pytest.raises(StoreError, match=r"000001.safetensors cannot be read(.|\n)*remove meta/playlearn/"):
        opened(copy)
    assert opened(copy, skip_broken=True).indices().tolist() == [0, 2]


def test_videos_that_are_missing_or_too_short_are_named(without_sidecars: Path) -> None:
    videos = sorted(without_sidecars.glob("videos/*/*/*.mp4"))
    if not videos:
        pytest.skip("no videos")
    rewrite(
        without_sidecars / EPISODES,
        lambda t: column(t, "videos/observation.images.wrist/from_timestamp", lambda a: a + 1.0),
    )
    with pytest.raises(
        StoreError, match=r"episode 2: videos/observation.images.wrist/.* ends at 4.50 s, the episode at 5.50"
    ):
        opened(without_sidecars)
    assert opened(without_sidecars, skip_broken=True).indices().tolist() == [0, 1]
    for video in videos:
        video.unlink()
    with pytest.raises(StoreError, match="3 of 3 without their images: `without_images: true`"):
        opened(without_sidecars, skip_broken=True)
    numbers_only = opened(without_sidecars, without_images=True)
    assert len(numbers_only) == 3
    assert numbers_only.cameras() == {}
    assert numbers_only.verify() == []


def test_an_incomplete_video_is_named(without_sidecars: Path) -> None:
    """Also if its index is at the front, as in videos for the web, and lists frames that are missing."""
    videos = sorted(without_sidecars.glob("videos/*/*/*.mp4"))
    if not videos:
        pytest.skip("no videos")
    other = videos[0].with_suffix(".new.mp4")
    with av.open(str(videos[0])) as old, av.open(str(other), "w", options={"movflags": "faststart"}) as new:
        new_stream = new.add_stream_from_template(old.streams.video[0])
        for packet in old.demux(video=0):
            if packet.dts is not None:
                packet.stream = new_stream
                new.mux(packet)
    other.replace(videos[0])
    assert opened(without_sidecars).verify() == []
    cut(videos[0])
    with pytest.raises(StoreError, match=r"\.mp4 is cut short at .* bytes: fetch it again \(episodes 0 to 2"):
        opened(without_sidecars)


def test_a_video_of_another_size_than_stated_is_named(without_sidecars: Path) -> None:
    if not any(without_sidecars.glob("videos/*/*/*.mp4")):
        pytest.skip("no videos")
    features = json.loads((without_sidecars / "meta" / "info.json").read_text())["features"]
    info(without_sidecars, features=features | {FRONT: {**features[FRONT], "shape": [32, 24, 3]}})
    with pytest.raises(
        StoreError, match=rf"000.mp4: {FRONT} is 16x24, where meta/info.json says 32x24: set `image_size`"
    ):
        opened(without_sidecars)
    assert opened(without_sidecars, image_size=(8, 12)).cameras()["front"] == (8, 12)


def test_a_missing_feature_is_named_with_those_that_exist(without_sidecars: Path) -> None:
    with pytest.raises(
        StoreError, match=r"no feature 'observation.joints' for the state; it has observation.state, .*set `state`"
    ):
        opened(without_sidecars, state="observation.joints")


def test_it_can_be_imported(copy: Path, store: NativeStore, tmp_path: Path) -> None:
    made = import_recordings(LeRobotRecordings(opened(copy, skip_broken=True)), tmp_path / "store")
    for i in range(3):
        np.testing.assert_array_equal(made.array(i, "sim.state"), store.array(i, "sim.state"))
        assert made.meta(i) == store.meta(i)
    BROKEN["not a number"][0](copy)
    broken = LeRobotRecordings(opened(copy, skip_broken=True))
    with pytest.raises(StoreError, match=r"1 of 3 recordings are broken(.|\n)*episode 1: action is not finite"):
        import_recordings(broken, tmp_path / "other")
    assert len(import_recordings(broken, tmp_path / "other", skip_broken=True)) == 2


def test_the_hub_is_used_only_for_a_dataset_that_is_not_local(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import huggingface_hub
    from huggingface_hub.errors import OfflineModeIsEnabled

    def offline(*_: object, **__: object) -> str:
        raise OfflineModeIsEnabled("offline mode is enabled")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", offline)
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))
    (tmp_path / "someone").mkdir()
    (tmp_path / "someone" / "play").symlink_to(exported)
    config = LeRobotStoreConfig(repo_id="someone/play", cache=tmp_path / "frames")
    assert len(config.build()) == 3
    with pytest.raises(StoreError, match=r"someone/else is not at .*, and the Hub cannot be reached \(offline mode"):
        LeRobotStoreConfig(repo_id="someone/else").build()
    with pytest.raises(UsageError, match=r"root.*or by its name on the Hub"):
        LeRobotStoreConfig()


def opened_config(root: Path) -> LeRobotStoreConfig:
    return LeRobotStoreConfig(root=root, cache=root.parent / "frames")
