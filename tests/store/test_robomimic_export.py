"""Export to robomimic's HDF5: its content, what reads back, and that a failure leaves nothing."""

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from playlearn.cli import main
from playlearn.data import DataConfig, PlayDataset
from playlearn.data.split import val_mask
from playlearn.errors import DiskError
from playlearn.relabeling import UniformConfig
from playlearn.store import NativeStore, StoreSpec
from playlearn.store.importing import import_recordings
from playlearn.store.robomimic import RobomimicConfig, RobomimicFile
from playlearn.store.robomimic_export import export_robomimic
from tests.synthetic import QUANTITIES, make_episode

h5py = pytest.importorskip("h5py", reason="the extra `robomimic` is not installed")
CAMERAS = {"front": (16, 24)}
MASKS = {"train": [1, 10], "valid": [2]}


@pytest.fixture
def store(tmp_path: Path) -> NativeStore:
    """Episodes 1, 2 and 10: the first succeeded at its task, the second did not, the third is play."""
    rng, succeeded = np.random.default_rng(0), {1: True, 2: False, 10: None}
    made = {n: make_episode(rng, 20 + n, CAMERAS, seed=n, success=success) for n, success in succeeded.items()}
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(made[1]))
    with store.writer() as writer:
        for number, episode in made.items():
            writer.append(episode, number)
    return store


def test_an_export_reads_back(store: NativeStore, tmp_path: Path) -> None:
    export_robomimic(store, tmp_path / "a.hdf5", MASKS)
    back = import_recordings(RobomimicFile(tmp_path / "a.hdf5"), tmp_path / "back")
    assert back.indices().tolist() == [1, 2, 10]  # the numbers they were recorded under, in numeric order
    assert back.spec.fps == 20
    assert [back.meta(i).success for i in range(3)] == [True, False, None]
    assert (back.spec.state_names, back.spec.achieved_names) == (store.spec.state_names, store.spec.achieved_names)
    assert back.spec.action_names == store.spec.action_names
    assert back.spec.quantities == store.spec.quantities == QUANTITIES
    for i in range(3):
        mine, its = store.read(i), back.read(i)
        for name in ("state", "achieved", "sim_state", "time", "expert_action"):
            np.testing.assert_array_equal(getattr(its, name), getattr(mine, name))
        np.testing.assert_array_equal(its.images["front"], mine.images["front"])
        assert its.meta.unobserved_step == {}
    assert back.remarks() == {}
    with h5py.File(tmp_path / "a.hdf5") as file:
        demo, mine = file["data/demo_10"], store.read(2)
        np.testing.assert_array_equal(demo["next_obs/object"][-1], mine.achieved[-1])
        np.testing.assert_array_equal(demo["next_obs/front_image"], mine.images["front"][1:])
        assert (demo.attrs["num_samples"], demo["dones"][()].tolist()) == (30, [0] * 29 + [1])
        assert [file[f"data/demo_{n}/rewards"][-1] for n in (1, 2, 10)] == [1, 0, 0]
        description = json.loads(file["data"].attrs["env_args"])["playlearn"]
    assert description["environment"] == {"type": "synthetic", "objects": 3}
    assert description["names"]["action"] == ["dx", "dy", "dz", "gripper"]


def test_masks_are_the_validation_split(store: NativeStore, tmp_path: Path) -> None:
    export_robomimic(store, tmp_path / "a.hdf5", MASKS)
    back = import_recordings(RobomimicFile(tmp_path / "a.hdf5"), tmp_path / "back")
    assert [back.meta(i).split for i in range(3)] == ["train", "val", "train"]
    data = DataConfig(goals=UniformConfig())
    shown = {split: PlayDataset(back, data, split).episodes.tolist() for split in ("train", "val")}
    assert shown == {"train": [0, 2], "val": [1]}
    assert not val_mask(back, 0.0).any()  # without a validation split all are for training
    # Nothing would be left to one side: then numbers decide, as for any play.
    for name, config in {"one": RobomimicConfig(mask="train"), "other": RobomimicConfig(mask="valid")}.items():
        part = import_recordings(config.build(tmp_path / "a.hdf5"), tmp_path / name)
        assert {part.meta(i).split for i in range(len(part))} == {""}


def test_the_command_writes_the_validation_split_as_a_mask(store: NativeStore, tmp_path: Path) -> None:
    out = tmp_path / "a.hdf5"
    assert main(["export", "robomimic", str(store.path), str(out)]) == 0
    val = store.indices()[val_mask(store, DataConfig().val_fraction)].tolist()
    assert RobomimicFile(out).splits["valid"] == val
    assert main(["export", "robomimic", str(store.path), str(out)]) == 1
    assert main(["export", "robomimic", str(store.path), str(tmp_path / "b"), "--goals"]) == 2
    assert main(["export", "policy", str(store.path), str(tmp_path / "b"), "--video.x=1"]) == 2
    assert not (tmp_path / "b").exists()


def test_a_full_disk_is_an_error_and_leaves_nothing(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 ends the process with a segmentation fault if a write fails under it, so it must never see one fail."""
    whole = tmp_path / "whole.hdf5"
    export_robomimic(store, whole, MASKS)
    write, size, room = os.pwrite, whole.stat().st_size, [0]

    def pwrite(descriptor: int, data: Any, at: int) -> int:
        if at + len(data) > room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[: len(data) // 2 + 1], at)  # less than was asked for, as the system may

    monkeypatch.setattr(os, "pwrite", pwrite)
    for room[0] in (0, 3000, size // 2, size - 1):
        with pytest.raises(DiskError, match=r"the disk is full; nothing was left at .*out/a.hdf5"):
            export_robomimic(store, tmp_path / "out" / "a.hdf5", MASKS)
        assert not (tmp_path / "out").exists(), "it was made for this"
    room[0] = size
    export_robomimic(store, tmp_path / "out" / "a.hdf5", MASKS)
    assert RobomimicFile(tmp_path / "out" / "a.hdf5").problems() == {}


def test_a_disk_that_fails_at_the_end_is_an_error(
    store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(DiskError, match="Input/output error"):
        export_robomimic(store, tmp_path / "out" / "a.hdf5", MASKS)
    assert not (tmp_path / "out" / "a.hdf5").exists()
