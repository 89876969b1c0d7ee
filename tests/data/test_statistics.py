"""Laws of the statistics that normalize."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from playlearn.data import DataConfig, statistics
from playlearn.data.statistics import statistics_of
from playlearn.policies import PolicySpec
from playlearn.policies.normalize import scaled
from playlearn.quantity import Quantities
from playlearn.relabeling import FinalConfig, SettlingConfig
from playlearn.store import NativeStore, StoreSpec
from tests.synthetic import make_episode, make_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> NativeStore:
    return make_store(tmp_path_factory.mktemp("data") / "play", np.random.default_rng(0), 5, 120)


def test_statistics_are_those_of_the_recorded_rows(store: NativeStore) -> None:
    data = DataConfig(val_fraction=0.25).build(store, "train", 0)
    found = statistics(data)
    rows = np.concatenate([store.read(int(i)).achieved for i in data.episodes])
    np.testing.assert_allclose(found["achieved"].mean, rows.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(found["achieved"].std, rows.std(axis=0), atol=1e-5)
    assert {value.dtype for value in vars(found["state"]).values()} == {np.dtype(np.float32)}


def test_a_dimension_that_never_varies_has_no_deviation_and_is_told_apart(tmp_path: Path) -> None:
    episode = make_episode(np.random.default_rng(0), 50)
    state = episode.state.copy()
    state[:, 1] = 0.3
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(episode))
    with store.writer() as writer:
        writer.append(dataclasses.replace(episode, state=state))
    found = statistics(DataConfig(goals=FinalConfig(), val_fraction=0.0).build(store, "train", 0))["state"]
    assert found.std[1] == 0.0
    assert found.varies.tolist() == [True, False, *[True] * (len(found.std) - 2)]
    assert abs(found.std[0] - state[:, 0].std()) < 1e-6


def test_motors_named_alike_are_normalized_each_by_its_own(tmp_path: Path) -> None:
    """`shoulder.pos` and `shoulder` are the same joint; after normalization each has mean 0 and std 1."""
    rng, made = np.random.default_rng(3), {}
    scales, motors = np.array([40.0, 1.0, 15.0, 0.01]), ("pan", "lift", "roll", "gripper")
    episodes = [make_episode(rng, 60, seed=seed) for seed in range(3)]
    for name, ending in (("dotted", ".pos"), ("plain", "")):
        names = tuple(motor + ending for motor in motors)
        metas = [dataclasses.replace(one.meta, state_names=names, quantities=Quantities()) for one in episodes]
        rows = [(one.state * scales + scales).astype(np.float32) for one in episodes]
        again = [
            dataclasses.replace(one, meta=meta, state=own) for one, meta, own in zip(episodes, metas, rows, strict=True)
        ]
        store = NativeStore.create(tmp_path / name, StoreSpec.of(again[0]))
        with store.writer() as writer:
            for episode in again:
                writer.append(episode)
        data = DataConfig(settling=SettlingConfig(source="robot"), goals=FinalConfig(), val_fraction=0.0)
        made[name] = data.build(store, "train", 0)
    dotted, plain = made["dotted"], made["plain"]
    spec = dotted.store.spec
    policy = PolicySpec(spec.state_names, spec.achieved_names, spec.action_names, spec.fps)
    one, other = (scaled(statistics(data), policy)["state"] for data in (dotted, plain))
    assert np.array_equal(one.mean, other.mean)
    assert np.array_equal(one.std, other.std)
    assert np.array_equal(dotted.table.moments, plain.table.moments)
    normal = (dotted.state - one.mean) / one.std
    np.testing.assert_allclose(normal.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(normal.std(axis=0), 1, atol=1e-4)


def test_a_turn_across_the_seam_is_a_small_spread() -> None:
    rng = np.random.default_rng(4)
    yaw = np.pi + rng.normal(0, 0.1, 400)
    rows = ((yaw + np.pi) % (2 * np.pi) - np.pi)[:, None].astype(np.float32)
    assert statistics_of(rows).std[0] > 3
    assert abs(statistics_of(rows, ("angle yaw",)).std[0] - 0.1) < 0.01
