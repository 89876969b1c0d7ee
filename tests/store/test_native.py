"""Guarantees of a store: whole episodes or none, one writer, and errors that say what to do."""

import dataclasses
import errno
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from playlearn.episode import Episode
from playlearn.errors import BusyError, DiskError, EpisodeError, StoreError
from playlearn.store import NativeStore, NativeStoreConfig, StoreSpec, episode_path, open_store, write_episode
from playlearn.store.base import to_json
from playlearn.store.mmap_cache import OPEN_MAPS
from tests.synthetic import SKILLS, make_episode, make_store


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def same(one: Episode, other: Episode) -> bool:
    mine, its = one.arrays(), other.arrays()
    equal = mine.keys() == its.keys() and all(np.array_equal(mine[key], its[key]) for key in mine)
    return equal and to_json(one.meta) == to_json(other.meta)


def test_episodes_read_back_equal(tmp_path: Path, rng: np.random.Generator) -> None:
    episode = make_episode(rng, 30, {"front": (8, 12), "wrist": (4, 4)}, seed=7)
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    with store.writer() as writer:
        assert writer.append(episode) == 0
    again = open_store(tmp_path / "play")
    assert same(again.read(0), episode)
    assert again.meta(0) == episode.meta
    assert again.spec == store.spec
    assert again.lengths().tolist() == [30]
    assert again.cameras() == {"front": (8, 12), "wrist": (4, 4)}
    assert again.verify() == []


def test_any_safetensors_reader_can_read_it(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 10, ("front",))
    loaded = load_file(episode_path(store.path, 0))
    expected = store.read(0).arrays()
    assert loaded.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_array_equal(loaded[key], value)
        assert loaded[key].dtype == value.dtype


def test_arrays_are_mapped_and_cannot_be_written(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 10, ("front",))
    frames = store.array(0, "observation.images.front")
    assert not frames.flags.owndata
    with pytest.raises(ValueError, match="read-only"):
        frames[0] = 0


def test_more_episodes_than_maps_can_be_read(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, OPEN_MAPS + 2, 2)
    first = store.array(0, "action").copy()
    kept = store.array(0, "action")
    for i in range(len(store)):
        store.array(i, "action")
    np.testing.assert_array_equal(kept, first)  # a view outlives its place among the open maps
    np.testing.assert_array_equal(store.array(0, "action"), first)


def test_episodes_come_in_any_order_and_are_read_by_number(tmp_path: Path, rng: np.random.Generator) -> None:
    episodes = {index: make_episode(rng, 5 + index, seed=index) for index in (9, 2, 5)}
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episodes[9]))
    with store.writer() as writer:
        for index, episode in episodes.items():
            assert writer.append(episode, index) == index
        with pytest.raises(StoreError, match="already has an episode 5"):
            writer.append(episodes[5], 5)
        assert writer.append(make_episode(rng, 3, seed=10)) == 10
    assert store.indices().tolist() == [2, 5, 9, 10]
    assert [store.meta(i).seed for i in range(4)] == [2, 5, 9, 10]
    assert store.lengths().tolist() == [7, 10, 14, 3]
    with pytest.raises(StoreError, match="no episode 4"):
        store.read(4)


def test_a_reader_shows_new_episodes_after_refresh(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 5)
    reader = open_store(store.path)
    write_episode(store.path, 1, make_episode(rng, 5))
    assert len(reader) == 1
    store.refresh()
    assert len(store) == 2


def test_a_job_that_is_run_again_gives_one_episode(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 5)
    episode = make_episode(rng, 5)
    assert write_episode(store.path, 3, episode) == write_episode(store.path, 3, episode)
    store.refresh()
    assert store.indices().tolist() == [0, 3]


def test_threads_may_read_at_once(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, OPEN_MAPS + 8, 2)
    expected = [store.array(i, "action").sum() for i in range(len(store))]
    wrong: list[int] = []

    def read(seed: int) -> None:
        drawn = np.random.default_rng(seed).integers(len(store), size=400).tolist()
        wrong.extend(i for i in drawn if store.array(i, "action").sum() != expected[i])

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from playlearn.store import open_store, write_episode
store = open_store(sys.argv[1])
episode = store.read(0)
os.fsync = lambda descriptor: os.kill(os.getpid(), 9)   # after the bytes, before the rename
with store.writer() as writer:
    writer.append(episode)
"""


def test_a_killed_writer_leaves_the_store_intact(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 2, 20)
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    killed = subprocess.run([sys.executable, "-c", KILLED, str(store.path)], env=env, check=False, timeout=600)
    assert killed.returncode == -9
    assert len(list((store.path / "episodes").iterdir())) == 3  # the half-written one is there ...
    again = NativeStore.open(store.path)
    assert len(again) == 2  # ... and no reader sees it
    assert again.verify() == []
    with again.writer() as writer:  # the dead writer's lock is free, its leavings are swept
        assert len(list((store.path / "episodes").iterdir())) == 2
        assert writer.append(make_episode(rng, 4)) == 2


def test_a_second_writer_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 5)
    with store.writer(), pytest.raises(BusyError, match=r"another process.*\.lock"), open_store(store.path).writer():
        pass
    with store.writer() as writer:
        writer.append(make_episode(rng, 5))


@pytest.mark.parametrize(("number", "message"), [(errno.ENOSPC, "the disk is full"), (errno.EIO, "cannot write")])
def test_a_full_disk_harms_nothing(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, number: int, message: str
) -> None:
    store = make_store(tmp_path / "play", rng, 3, 20)

    def full(descriptor: int) -> None:
        raise OSError(number, os.strerror(number))

    with store.writer() as writer, monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(DiskError, match=f"{message}.*3 episodes are safe"):
            writer.append(make_episode(rng, 20))
    assert len(list((store.path / "episodes").iterdir())) == 3
    assert NativeStore.open(store.path).verify() == []


@pytest.mark.parametrize("where", ["header", "arrays"])
def test_verify_finds_a_flipped_bit(tmp_path: Path, rng: np.random.Generator, where: str) -> None:
    store = make_store(tmp_path / "play", rng, 3, 20, ("front",))
    path = episode_path(store.path, 1)
    content = bytearray(path.read_bytes())
    at = content.index(b"player") if where == "header" else len(content) - 1
    content[at] ^= 1
    path.write_bytes(content)
    problems = open_store(store.path).verify()
    assert len(problems) == 1
    assert "000001" in problems[0]
    assert "checksum" in problems[0]


def test_a_truncated_file_is_named_when_the_store_is_opened(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 2, 20)
    path = episode_path(store.path, 1)
    whole = path.read_bytes()
    for size in (0, 4, 100, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(StoreError, match=r"000001\.safetensors.*delete it"):
            open_store(store.path)
    with pytest.raises(StoreError, match="open it again"):
        store.read(1)


def test_a_nan_never_becomes_an_episode(rng: np.random.Generator) -> None:
    episode = make_episode(rng, 10)
    action = episode.action.copy()
    action[4, 1] = np.nan
    with pytest.raises(EpisodeError, match="action is not finite at step 4: dimension 1 is nan"):
        dataclasses.replace(episode, action=action)


def test_two_dimensions_of_one_name_never_become_an_episode(rng: np.random.Generator) -> None:
    episode = make_episode(rng, 10)
    names = dataclasses.replace(episode.meta, state_names=("eef.x", "eef.y", "eef.x", "gripper.opening"))
    with pytest.raises(EpisodeError, match=r"state_names has 'eef.x' twice"):
        dataclasses.replace(episode, meta=names)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"environment": {"type": "another"}}, "environment"),
        ({"fps": 10.0}, "fps"),
        ({"action_names": ("dx", "dy", "dz", "grip")}, "action_names"),
    ],
)
def test_an_episode_of_another_environment_is_refused(
    tmp_path: Path, rng: np.random.Generator, change: dict[str, object], message: str
) -> None:
    store = make_store(tmp_path / "play", rng, 1, 10)
    episode = make_episode(rng, 10)
    other = dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, **change))
    with store.writer() as writer, pytest.raises(StoreError, match=f"{message} differs.*store of its own"):
        writer.append(other)
    elsewhere = NativeStore.create(tmp_path / "other", StoreSpec.of(other))
    with elsewhere.writer() as writer:
        writer.append(other)
    episode_path(elsewhere.path, 0).rename(episode_path(store.path, 1))
    with pytest.raises(StoreError, match=f"000001.*{message} differs"):
        open_store(store.path)


def test_an_episode_with_other_cameras_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 10, ("front",))
    for cameras in ((), {"front": (8, 8)}, ("front", "wrist")):
        with store.writer() as writer, pytest.raises(StoreError, match="cameras differs"):
            writer.append(make_episode(rng, 10, cameras))


def test_other_folders_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(StoreError, match=r"there is no store at .*nowhere.*playlearn collect"):
        open_store(tmp_path / "nowhere")
    with pytest.raises(StoreError, match="is not a store"):
        open_store(tmp_path)
    store = make_store(tmp_path / "play", rng, 1, 5)
    description = json.loads((store.path / "store.json").read_text())
    for change, message in (
        ({"version": 2}, "newer playlearn.*update"),
        ({"format": "zarr"}, "format 'zarr'"),
        ({"color": "red"}, "unknown color"),
    ):
        (store.path / "store.json").write_text(json.dumps(description | change))
        with pytest.raises(StoreError, match=message):
            open_store(store.path)
    for text in ("{", "[]", "{}", json.dumps({"format": "playlearn", "version": 1})):
        (store.path / "store.json").write_text(text)
        with pytest.raises(StoreError, match=r"store\.json|StoreSpec"):
            open_store(store.path)


def test_a_folder_in_use_is_not_made_a_store(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 5)
    with pytest.raises(StoreError, match=r"already a store.*--resume"):
        NativeStore.create(store.path, store.spec)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").touch()
    with pytest.raises(StoreError, match="name another folder"):
        NativeStore.create(tmp_path / "photos", store.spec)


def test_a_kill_while_a_store_is_made_can_be_repeated(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "play" / "episodes").mkdir(parents=True)
    (tmp_path / "play" / ".store.json.1-2.tmp").touch()
    assert len(NativeStore.create(tmp_path / "play", StoreSpec.of(make_episode(rng, 5)))) == 0


def test_images_can_be_replaced(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 1, 10, ("front",))
    frames = np.full((11, 6, 8, 3), 9, np.uint8)
    episode = store.with_images(0, {"side": frames}, "egl on llvmpipe")
    assert set(episode.images) == {"side"}
    assert episode.meta.cameras == {"side": {"height": 6, "width": 8}}
    assert episode.meta.renderer == "egl on llvmpipe"
    np.testing.assert_array_equal(episode.sim_state, store.read(0).sim_state)
    other = NativeStore.create(tmp_path / "other", StoreSpec.of(episode))
    with other.writer() as writer:
        writer.append(episode, int(store.indices()[0]))
    assert other.cameras() == {"side": (6, 8)}


def test_info_counts_what_is_there(tmp_path: Path, rng: np.random.Generator) -> None:
    store = make_store(tmp_path / "play", rng, 3, 100, {"front": (8, 12)})
    info = json.loads(json.dumps(store.info()))
    assert info["episodes"] == 3
    assert info["steps"] == 300
    assert info["seconds"] == 15.0  # 300 steps at 20 Hz
    assert info["cameras"] == {"front": {"height": 8, "width": 12}}
    assert info["actors"] == {"player": 3}
    assert info["ended"] == {"length": 3}
    assert info["versions"] == {"playlearn": ["0"]}
    assert set(info["skills"]) <= set(SKILLS)
    runs = sum(1 + int((np.diff(store.array(i, "skill")) != 0).sum()) for i in range(3))
    assert sum(info["skills"].values()) == runs
    assert info["bytes"] == sum(path.stat().st_size for path in (store.path / "episodes").iterdir())


def test_a_config_opens_its_store(tmp_path: Path, rng: np.random.Generator) -> None:
    make_store(tmp_path / "play", rng, 1, 5)
    assert len(NativeStoreConfig(tmp_path / "play").build()) == 1


def test_a_store_that_does_not_say_what_its_numbers_measure_is_refused(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    make_store(tmp_path / "play", rng, 1, 5)
    path = tmp_path / "play" / "store.json"
    description = json.loads(path.read_text())
    del description["quantities"]
    path.write_text(json.dumps(description))
    with pytest.raises(
        StoreError, match=r"store\.json: .*what its numbers measure .*; collect or import the recording again"
    ):
        NativeStore.open(tmp_path / "play")


def test_a_declaration_is_of_every_number(rng: np.random.Generator) -> None:
    episode = make_episode(rng, 5)
    short = dataclasses.replace(episode.meta.quantities, state=("length x",))
    with pytest.raises(EpisodeError, match=r"quantities\.state declares 1 of 4"):
        dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, quantities=short))
