"""Export to LeRobot: what is written is what LeRobot reads."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from playlearn.episode import Episode
from playlearn.errors import DiskError, StoreError
from playlearn.store import LeRobotStoreConfig, NativeStore, StoreSpec
from playlearn.store.importing import import_recordings
from playlearn.store.lerobot import export as exporting
from playlearn.store.lerobot.content import PLAY, Content, Play
from playlearn.store.lerobot.export import Codec, export_lerobot, write_lerobot
from playlearn.store.lerobot.recordings import LeRobotRecordings
from tests.lerobot_dataset import encoded, image, vector, write_dataset
from tests.synthetic import SKILLS, make_episode, make_store

# What LeRobot and the packages below it warn of is theirs to fix.
pytestmark = pytest.mark.filterwarnings("ignore")
LENGTHS = (30, 12, 25)
CAMERAS = {"front": (48, 64), "wrist": (48, 48)}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    rng = np.random.default_rng(0)
    made = [make_episode(rng, steps, CAMERAS, seed=seed) for seed, steps in enumerate(LENGTHS)]
    return _stored(tmp_path_factory.mktemp("lerobot") / "play", made)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder for LeRobot's cache, instead of the user's."""
    import datasets

    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr(datasets.config, "HF_DATASETS_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def exported(store: NativeStore, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    done: list[tuple[int, int]] = []
    out = tmp_path_factory.mktemp("out") / "made" / "play"
    fidelity = export_lerobot(store, out, progress=lambda *args: done.append(args))
    assert {camera: read.worst for camera, read in fidelity.items()} == dict.fromkeys(CAMERAS, np.inf)  # to the pixel
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert [path.name for path in out.parent.iterdir()] == ["play"]  # nothing is left beside it
    return out


def test_every_frame_of_others_comes_back(cache: Path, tmp_path: Path) -> None:
    """The last one too, where nobody saw what its action led to: nothing is learned from it, and nothing is lost."""
    rng, lengths = np.random.default_rng(0), (12, 9)
    frames = rng.integers(0, 255, (sum(lengths), 48, 64, 3)).astype(np.uint8)
    columns = {
        "observation.state": rng.normal(size=(sum(lengths), 3)).tolist(),
        "action": rng.normal(size=(sum(lengths), 2)).tolist(),
        "next.reward": np.arange(sum(lengths), dtype=np.float32),
    }
    features = {"observation.state": vector(["x", "y", "gripper"]), "action": vector(["dx", "dy"])}
    features |= {"next.reward": vector(None, 1), "observation.images.top": image(48, 64, 3)}
    tasks = [["pick: it"] * 12, ["put_it"] * 9]
    cells = {"observation.images.top": encoded(frames)}
    source = write_dataset(tmp_path / "source", features, columns | cells, lengths, tasks)
    config = LeRobotStoreConfig(root=source, cache=tmp_path / "frames")
    store = import_recordings(LeRobotRecordings(config.build()), tmp_path / "play")
    assert store.lengths().tolist() == [11, 8]
    export_lerobot(store, tmp_path / "back")
    back = pq.read_table(tmp_path / "back" / "data")
    for key, own in columns.items():
        given = np.array(back[key].to_pylist()).reshape(sum(lengths), -1)
        np.testing.assert_array_equal(given, np.asarray(own, np.float32).reshape(sum(lengths), -1))
    again = LeRobotStoreConfig(root=tmp_path / "back", cache=tmp_path / "frames").build()
    for i, begin in enumerate((0, 12)):
        mine, its = store.read(i), again.read(i)
        assert its.meta == mine.meta
        np.testing.assert_array_equal(mine.images["top"], frames[begin : begin + lengths[i]])
        for key, value in mine.arrays().items():
            np.testing.assert_array_equal(its.arrays()[key], value)


@pytest.mark.slow
def test_lerobot_reads_every_frame_back(store: NativeStore, exported: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/play", root=exported)
    assert dataset.num_episodes == 3
    assert len(dataset) == sum(LENGTHS)
    assert dataset.fps == 20
    at = 0
    for i, length in enumerate(LENGTHS):
        episode = store.read(i)
        for t in range(length):
            read = dataset[at + t]
            assert int(read["episode_index"]) == i
            assert int(read["frame_index"]) == t
            assert abs(float(read["timestamp"]) - t / 20) < 1e-6
            np.testing.assert_array_equal(read["observation.state"], episode.state[t])
            np.testing.assert_array_equal(read["observation.environment_state"], episode.achieved[t])
            np.testing.assert_array_equal(read["action"], episode.expert_action[t])  # the label, not the noise
            for camera in CAMERAS:
                picture = np.rint(np.moveaxis(read[f"observation.images.{camera}"].numpy() * 255, 0, -1))
                np.testing.assert_array_equal(picture, episode.images[camera][t])
            assert read["task"] == SKILLS[episode.skill[t]]
            assert not read["intervention"]
        at += length
    assert dataset.meta.features["action"]["names"] == list(store.spec.action_names)


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["av1", "h264"])
def test_videos_read_back_with_little_loss(store: NativeStore, cache: Path, tmp_path: Path, codec: Codec) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    fidelity = export_lerobot(store, tmp_path / "films", videos=codec)
    assert len(list((tmp_path / "films").glob("videos/*/*/*.mp4"))) == 2
    dataset = LeRobotDataset("local/films", root=tmp_path / "films", video_backend="pyav")
    picture = np.moveaxis(dataset[40]["observation.images.front"].numpy() * 255, 0, -1)
    # Frame 40 of the dataset is frame 10 of the second episode, which is 12 long.
    error = np.square(picture - store.read(1).images["front"][10]).mean()
    # The PSNR of the worst episode holds for one of its frames to within a few dB.
    assert 10 * np.log10(255**2 / error) > fidelity["front"].worst - 4
    assert fidelity["front"].worst <= fidelity["front"].mean < 60  # lossy


def test_a_store_without_images_can_be_exported(cache: Path, tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 1, 10)
    export_lerobot(store, tmp_path / "out")
    assert (tmp_path / "out" / "meta" / "info.json").exists()


@pytest.mark.slow
def test_skills_can_be_exported_as_subtasks(store: NativeStore, cache: Path, tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    write_lerobot(Play(store, annotated=True), tmp_path / "out")
    dataset = LeRobotDataset("local/out", root=tmp_path / "out")
    episode = store.read(0)
    for t in range(len(episode)):
        read = dataset[t]
        assert read["task"] == PLAY
        # what is being done: the last annotation that has begun
        begun = [row for row in read["language_persistent"] if row["timestamp"] <= t / 20 + 1e-6]
        assert begun[-1]["content"] == SKILLS[episode.skill[t]]
        assert {row["style"] for row in begun} == {"subtask"}


def test_success_and_rewards_are_exported_if_known_of_every_episode(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    tried = [
        make_episode(rng, 5, task="open the drawer", success=success, reward=np.arange(5.0) - 2)
        for success in (True, False)
    ]
    tried[0].intervention.flags.writeable = True
    tried[0].intervention[2] = True
    content = Play(_stored(tmp_path / "tried", tried))
    entries = [content.entry(i) for i in range(2)]
    assert [set(entry.tasks) for entry in entries] == [{"open the drawer"}] * 2
    assert [entry.columns["next.success"][:, 0].tolist() for entry in entries] == [[False] * 4 + [True], [False] * 5]
    assert entries[0].columns["intervention"][:, 0].tolist() == [False, False, True, False, False]
    assert entries[0].columns["next.reward"][:, 0].tolist() == [-2, -1, 0, 1, 2]
    content = Play(_stored(tmp_path / "played", [tried[0], make_episode(rng, 5)]))
    assert set(content.entry(1).tasks) <= set(SKILLS)
    assert not {"next.success", "next.reward"} & (content.features() | content.entry(0).columns).keys()


def test_what_cannot_be_exported_is_refused(store: NativeStore, exported: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(StoreError, match="already exists: name another folder"):
        export_lerobot(store, tmp_path / "taken")
    with pytest.raises(StoreError, match="already exists, a LeRobot dataset"):
        export_lerobot(store, exported)
    empty = NativeStore.create(tmp_path / "empty", store.spec)
    with pytest.raises(StoreError, match="nothing to export"):
        export_lerobot(empty, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_behind(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    (tmp_path / ".out.building" / "out" / "data").mkdir(parents=True)  # of an export that was killed before

    def fail(*args: object) -> None:
        raise failure

    monkeypatch.setattr(exporting, "_read_back", fail)
    with pytest.raises((DiskError, KeyboardInterrupt), match=r"the disk is full; nothing was left at .*out$|^$"):
        export_lerobot(store, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_export_that_reads_back_differently_is_discarded(
    store: NativeStore, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    actual = exporting._write

    def shifted(content: Content, root: Path, *settings: Any) -> None:
        actual(Play(make_store(tmp_path / "other", np.random.default_rng(1), 3, 20, CAMERAS)), root, *settings)

    monkeypatch.setattr(exporting, "_write", shifted)
    with pytest.raises(StoreError, match="20 frames of episode 0, where 30 were written"):
        export_lerobot(store, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def _stored(path: Path, episodes: list[Episode]) -> NativeStore:
    store = NativeStore.create(path, StoreSpec.of(episodes[0]))
    with store.writer() as writer:
        for episode in episodes:
            writer.append(episode)
    return store
