"""Laws of mixing datasets: shares hold exactly, every example is shown, and nothing depends on ranks or resumption."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from playlearn.batch import Batch
from playlearn.config import from_dict
from playlearn.data import DataConfig, PlayDataset
from playlearn.data.mixture import DatasetMixture, DatasetSource, build_sources, mix_datasets
from playlearn.errors import CheckpointError, StoreError, UsageError
from playlearn.policies import Policy
from playlearn.relabeling import FinalConfig
from playlearn.store import NativeStore, StoreSpec, open_store
from playlearn.training import train
from tests.synthetic import make_episode, make_store
from tests.training.test_train import config as training

torch.set_num_threads(1)
CONFIG = DataConfig(chunk=4, goals=FinalConfig(), val_fraction=0.0)


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three stores of two short episodes each, and one without cameras' sizes in common."""
    folder = tmp_path_factory.mktemp("mixed")
    for number in range(3):
        make_store(folder / str(number), np.random.default_rng(number), episodes=2, steps=20 + number)
    return [folder / str(number) for number in range(3)]


def parts(stores: list[Path]) -> list[PlayDataset]:
    return [CONFIG.build(open_store(path), "train", 7 + number) for number, path in enumerate(stores)]


def taken(batches: Iterator[Batch], count: int) -> list[Batch]:
    with closing(cast(Any, batches)):
        return list(islice(batches, count))


def same(one: Batch, other: Batch) -> bool:
    names = [entry.name for entry in fields(Batch) if not isinstance(getattr(one, entry.name), dict)]
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)


def test_every_part_gets_its_fraction_of_any_stretch(stores: list[Path]) -> None:
    """Of 1,000 places 500 and 200, wherever they begin, to within 1 a part; and a part's own places leave none out."""
    first, second, own = parts(stores)
    mixed = DatasetMixture(own, [(first, 0.5), (second, 0.2)])
    for start in (0, 1, 17, 10**9):
        counts = [len(places) for places in mixed.places(start, 1000)]
        assert sum(counts) == 1000
        np.testing.assert_allclose(counts, [500, 200, 300], atol=1)
    ahead = [np.concatenate(rows) for rows in zip(*(mixed.places(s, 64) for s in range(0, 640, 64)), strict=True)]
    for places in ahead:
        np.testing.assert_array_equal(places, np.arange(len(places)))


def test_a_batch_does_not_depend_on_ranks_or_on_where_it_was_resumed(stores: list[Path]) -> None:
    first, _, own = parts(stores)
    mixed = DatasetMixture(own, [(first, 0.3)])
    whole = taken(mixed.batches(10), 12)  # 120 examples of two epochs of 40 and 44: some begin anew
    resumed = taken(mixed.batches(10, start_step=5), 7)
    assert all(same(one, other) for one, other in zip(whole[5:], resumed, strict=True))
    second_rank = taken(mixed.batches(10, rank=1, ranks=2), 6)
    assert all(same(one, other) for one, other in zip(whole[1::2], second_rank, strict=True))
    assert not same(whole[0], whole[4])


def test_each_part_walks_through_its_own_epochs(stores: list[Path]) -> None:
    """The first 40 examples of a part of 40 are each of its examples once, whatever stands between them."""
    first, _, own = parts(stores)
    assert len(first) == 40
    mixed = DatasetMixture(own, [(first, 0.5)])
    shown = torch.cat([batch.state[:, -1] for batch in taken(mixed.batches(8), 10)])
    recorded = {tuple(row) for row in first.batch(0, np.arange(40)).state[:, -1].numpy().round(6).tolist()}
    mine = [tuple(row) for row in shown.numpy().round(6).tolist() if tuple(row) in recorded]
    assert len(mine) == len(set(mine)) == 40


def test_what_cannot_be_mixed_is_refused(stores: list[Path], tmp_path: Path) -> None:
    first, second, own = parts(stores)
    with pytest.raises(UsageError, match="add up to 1"):
        DatasetMixture(own, [(first, 0.5), (second, 0.5)])
    with pytest.raises(UsageError, match="add up to 1"):
        build_sources(own, [DatasetSource(stores[0], 0.5), DatasetSource(stores[1], 0.5)], 0)
    for fraction in (0.0, 1.0, -0.2):
        with pytest.raises(UsageError, match="between 0 and 1"):
            DatasetSource(stores[0], fraction)
    with pytest.raises(StoreError, match="no store"):
        build_sources(own, [DatasetSource(tmp_path / "nowhere", 0.5)], 0)
    assert mix_datasets(own, []) is own
    make_store(tmp_path / "seen", np.random.default_rng(0), episodes=2, steps=20, cameras=("front",))
    seeing = replace(CONFIG, cameras=("front",)).build(open_store(tmp_path / "seen"), "train", 0)
    with pytest.raises(UsageError, match="another size of front"):
        build_sources(seeing, [DatasetSource(stores[0], 0.5)], 0)


@pytest.mark.slow
def test_training_goes_on_from_another_run_with_more_play(stores: list[Path], tmp_path: Path) -> None:
    """At a learning rate of almost nothing the weights stay those of the start; its normalizer stays at any rate."""
    play = str(stores[0])
    goals = {"data": {"goals": {"type": "final"}}}
    train(training(play, **goals), tmp_path / "start")
    start = load_file(tmp_path / "start" / "policy" / "policy.safetensors")
    own = training(play).policy
    more = goals | {
        "extra_datasets": [{"store": str(stores[1]), "fraction": 0.5}],
        "init_from": str(tmp_path / "start"),
        "weight_decay": 0.0,
    }
    still, moved = training(play, lr=1e-12, **more), training(play, lr=1e-2, **more)
    train(still, tmp_path / "still")
    train(moved, tmp_path / "moved")
    after = {run: load_file(tmp_path / run / "policy" / "policy.safetensors") for run in ("still", "moved")}
    for name, value in start.items():
        torch.testing.assert_close(after["still"][name], value, rtol=0, atol=1e-6)
    assert any(not torch.equal(after["moved"][name], value) for name, value in start.items())
    kept = [name for name in start if name.startswith("normalizer")]
    assert kept
    assert all(torch.equal(after["moved"][name], start[name]) for name in kept)
    assert Policy.load(tmp_path / "moved" / "policy").config == own
    for changed in ({"goal_dropout": 0.9}, {"chunk": own.chunk + 1}, {"history": 2}):
        with pytest.raises(UsageError, match=f"has another .*{next(iter(changed))}"):
            train(replace(moved, policy=replace(own, **changed)), tmp_path / "other")
    with pytest.raises(CheckpointError, match="no policy"):
        train(replace(moved, init_from=tmp_path / "nowhere"), tmp_path / "none")


def test_a_source_is_cut_as_the_policy_asks() -> None:
    """History, chunk and cameras are the policy's in every store; what the source says itself it keeps."""
    given = {
        "extra_datasets": [
            {"store": "more", "fraction": 0.25, "data": {"max_label_deviation": 0.1, "chunk": 99}},
            {"store": "b", "fraction": 0.1},
        ]
    }
    resolved = training("play", **given).resolved()
    first, second = resolved.extra_datasets
    assert first.data is not None
    assert (first.data.chunk, first.data.max_label_deviation) == (4, 0.1)
    assert second.data == resolved.data
    assert from_dict(type(resolved), {"store": "play"}).extra_datasets == ()


def test_a_difference_is_reported_of_both_stores(tmp_path: Path) -> None:
    mine = make_store(tmp_path / "mine", np.random.default_rng(0), 2, 60)
    episode = make_episode(np.random.default_rng(0), 60)
    meta = replace(episode.meta, fps=10.0, action_names=("dx", "dy", "dz", "grip"))
    other = NativeStore.create(tmp_path / "other", StoreSpec.of(replace(episode, meta=meta)))
    with other.writer() as writer:
        writer.append(replace(episode, meta=meta))
    own = PlayDataset(mine, DataConfig(val_fraction=0))
    words = r"another action_names \(it has grip; it lacks gripper\), fps \(10.0, not 20.0\) than"
    with pytest.raises(UsageError, match=words):
        build_sources(own, [DatasetSource(tmp_path / "other", 0.5)], 0)
