"""Laws of batches without end: resumed, shared by ranks, augmented, closed."""

import threading
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from playlearn.batch import Batch
from playlearn.data import AugmentedDataset, DataConfig, Indices, Recorded
from playlearn.store import NativeStore
from tests.data.parts import equal
from tests.synthetic import make_store

torch.set_num_threads(1)
CAMERAS = {"front": (8, 10), "wrist": (6, 6)}
SEEN = DataConfig(cameras=("front", "wrist"), goal_cameras=("front",), history=3, chunk=8, val_fraction=0.0)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("data") / "play", np.random.default_rng(0), 5, 120, CAMERAS)


@pytest.mark.parametrize("start", [0, 3, 7])
def test_batches_go_on_exactly_where_they_stopped(store: NativeStore, start: int) -> None:
    data = SEEN.build(store, "train", 0)
    size = len(data) // 3 + 1  # a batch straddles the end of each epoch
    unbroken = list(islice(data.batches(size), 9))
    resumed = list(islice(data.batches(size, start_step=start), 9 - start))
    assert all(equal(one, other) for one, other in zip(unbroken[start:], resumed, strict=True))
    assert not equal(unbroken[0], unbroken[3])


def test_an_augmentation_is_given_the_epoch_and_the_examples_of_each_place(store: NativeStore) -> None:
    """One that changes nothing leaves the stream as it is; one that moves to the next example moves all fields."""
    data = DataConfig(val_fraction=0.0).build(store, "train", 0)

    def unchanged(recorded: Recorded, epoch: int | Indices, indices: Indices) -> Batch:
        return recorded(epoch, indices)

    def following(recorded: Recorded, epoch: int | Indices, indices: Indices) -> Batch:
        return recorded(epoch, (indices + 1) % len(data))

    plain, same = (islice(one.batches(64), 12) for one in (data, AugmentedDataset(data, unchanged)))
    assert all(equal(one, other) for one, other in zip(plain, same, strict=True))
    moved, order = AugmentedDataset(data, following), data.epoch_indices(0)[:10]
    assert equal(next(moved.batches(10)), data.batch(0, (order + 1) % len(data)))
    assert equal(data.batch(0, order), next(data.batches(10)))  # what it was made of stays as it is


def test_ranks_share_the_work_of_one(store: NativeStore) -> None:
    data = DataConfig(val_fraction=0.0).build(store, "train", 0)
    whole = list(islice(data.batches(32), 4))
    ranks = [list(islice(data.batches(16, rank=rank, ranks=2), 4)) for rank in range(2)]
    for step in range(4):
        halves = torch.cat([ranks[rank][step].action for rank in range(2)])
        torch.testing.assert_close(halves, whole[step].action, rtol=0, atol=0)


def test_closing_the_iterator_ends_its_thread(store: NativeStore) -> None:
    batches = DataConfig(val_fraction=0.0).build(store, "train", 0).batches(4)
    next(batches)
    assert "batches" in {thread.name for thread in threading.enumerate()}
    batches.close()
    assert "batches" not in {thread.name for thread in threading.enumerate()}


def test_an_error_in_the_thread_reaches_the_caller(tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 1, 100, ("front",))
    data = DataConfig(cameras=("front",), val_fraction=0.0).build(store, "train", 0)
    data.store = make_store(tmp_path / "blind", np.random.default_rng(0), 1, 100)
    with pytest.raises(KeyError, match="front"):
        next(data.batches(4))
