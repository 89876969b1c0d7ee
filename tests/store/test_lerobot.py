"""What is exported is what LeRobot reads, and what its own training command takes as it is."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from playlearn.errors import StoreError
from playlearn.store import NativeStore, StoreSpec
from playlearn.store import lerobot as exporting
from playlearn.store.lerobot import PLAY, export_lerobot, frames
from tests.synthetic import SKILLS, make_episode, make_store

# What LeRobot and the packages below it warn of is theirs to mend.
pytestmark = pytest.mark.filterwarnings("ignore")
LENGTHS = (30, 12, 25)
CAMERAS = {"front": (48, 64), "wrist": (48, 48)}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    rng = np.random.default_rng(0)
    made = [make_episode(rng, steps, CAMERAS, seed=seed) for seed, steps in enumerate(LENGTHS)]
    store = NativeStore.create(tmp_path_factory.mktemp("lerobot") / "play", StoreSpec.of(made[0]))
    with store.writer() as writer:
        for episode in made:
            writer.append(episode)
    return store


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where LeRobot keeps its copy of what it opens, instead of the user's own cache."""
    import datasets

    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr(datasets.config, "HF_DATASETS_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def exported(store: NativeStore, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    done: list[tuple[int, int]] = []
    out = tmp_path_factory.mktemp("out") / "made" / "play"
    assert export_lerobot(store, out, progress=lambda *args: done.append(args)) == out
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert [path.name for path in out.parent.iterdir()] == ["play"]  # nothing is left beside it
    return out


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
        at += length
    assert dataset.meta.features["action"]["names"] == list(store.spec.action_names)


def test_videos_read_back_much_alike(store: NativeStore, cache: Path, tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    out = export_lerobot(store, tmp_path / "films", videos=True)
    assert len(list(out.glob("videos/*/*/*.mp4"))) == 2
    dataset = LeRobotDataset("local/films", root=out, video_backend="pyav")
    picture = np.moveaxis(dataset[40]["observation.images.front"].numpy() * 255, 0, -1)
    # Frame 40 of the dataset is frame 10 of the second episode, which is 12 long.
    assert np.abs(picture - store.read(1).images["front"][10]).mean() < 16


def test_a_store_without_images_can_be_exported(cache: Path, tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 1, 10)
    out = export_lerobot(store, tmp_path / "out")
    assert (out / "meta" / "info.json").exists()


def test_the_task_is_the_episodes_own_then_the_skill_then_play() -> None:
    rng = np.random.default_rng(0)
    named = make_episode(rng, 5, task="open the drawer")
    assert {frame["task"] for frame in frames(named)} == {"open the drawer"}
    played = make_episode(rng, 5)
    assert [frame["task"] for frame in frames(played)] == [SKILLS[skill] for skill in played.skill]
    object.__setattr__(played.meta, "skills", tuple(f"{skill}:planned:slip" for skill in SKILLS))
    assert [frame["task"] for frame in frames(played)] == [SKILLS[skill] for skill in played.skill]
    object.__setattr__(played.meta, "skills", ())
    assert {frame["task"] for frame in frames(played)} == {PLAY}


def test_what_cannot_be_exported_is_said(store: NativeStore, tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(StoreError, match="name another folder"):
        export_lerobot(store, tmp_path / "taken")
    empty = NativeStore.create(tmp_path / "empty", store.spec)
    with pytest.raises(StoreError, match="nothing to export"):
        export_lerobot(empty, tmp_path / "out")


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_behind(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    (tmp_path / ".out.building" / "data").mkdir(parents=True)  # of an export that was killed before

    def fail(*args: object) -> None:
        raise failure

    monkeypatch.setattr(exporting, "_read_back", fail)
    with pytest.raises((StoreError, KeyboardInterrupt), match=r"No space left|^$"):
        export_lerobot(store, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_export_that_reads_back_otherwise_is_thrown_away(
    store: NativeStore, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    actual = exporting._write

    def shifted(store: NativeStore, root: Path, name: str, videos: bool, progress: None) -> None:
        other = make_store(tmp_path / "other", np.random.default_rng(1), 3, 20, CAMERAS)
        actual(other, root, name, videos, progress)

    monkeypatch.setattr(exporting, "_write", shifted)
    with pytest.raises(StoreError, match="60 frames, where 67 were written"):
        export_lerobot(store, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_lerobot_train_takes_it_unmodified(exported: Path, tmp_path: Path) -> None:
    settings = {
        "dataset.repo_id": "local/play",
        "dataset.root": exported,
        "policy.type": "act",
        "policy.push_to_hub": "false",
        "policy.device": "cpu",
        "policy.pretrained_backbone_weights": "null",
        "policy.dim_model": 32,
        "policy.n_heads": 2,
        "policy.dim_feedforward": 64,
        "policy.chunk_size": 4,
        "policy.n_action_steps": 4,
        "num_workers": 0,
        "steps": 2,
        "batch_size": 2,
        "log_freq": 1,
        "output_dir": tmp_path / "run",
    }
    train = Path(sys.executable).with_name("lerobot-train")
    done = subprocess.run(
        [train, *(f"--{name}={value}" for name, value in settings.items())],
        env={**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home"), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    losses = [float(value) for value in re.findall(r"loss:([\d.]+) grdn", done.stderr + done.stdout)]
    assert len(losses) == 2  # one line a step
    assert np.isfinite(losses).all()
    assert list((tmp_path / "run" / "checkpoints").glob("*/pretrained_model/model.safetensors"))
