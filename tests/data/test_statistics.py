"""Laws of the statistics that normalize."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from playlearn.data import DataConfig, statistics
from playlearn.relabeling import FinalConfig
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
