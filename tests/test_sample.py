"""The play in datasets/sample: intact, small, of the present scene, with a matching card."""

from pathlib import Path

import numpy as np
import pytest

from playlearn.collection import CollectConfig, episode_seed
from playlearn.config import from_dict, load_config
from playlearn.data import DataConfig
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.report.store_report import write_report
from playlearn.sim import Environment, EnvironmentConfig
from playlearn.store import NativeStore

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "datasets" / "sample"
CONFIG = ROOT / "configs" / "collect" / "sample.yaml"


@pytest.fixture(scope="module")
def store() -> NativeStore:
    return NativeStore.open(SAMPLE)


def test_it_is_intact_and_under_8_megabytes(store: NativeStore) -> None:
    assert store.verify() == []
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*") if file.is_file()) < 8e6
    assert store.cameras() == {"front": (48, 64), "wrist": (32, 32)}


def test_it_is_what_its_config_makes(store: NativeStore) -> None:
    """After a change of configs/collect/sample.yaml or of a default of play: `make sample`."""
    config = load_config(CollectConfig, CONFIG)
    assert load_config(CollectConfig, SAMPLE / "collect.yaml") == config
    assert [store.meta(i).seed for i in range(len(store))] == [
        episode_seed(config.seed, i) for i in range(config.episodes)
    ]


def test_its_card_is_of_this_store(store: NativeStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    write_report(NativeStore.open(SAMPLE.relative_to(ROOT)), tmp_path / "README.md", unneeded)
    assert (tmp_path / "README.md").read_text() == (SAMPLE / "README.md").read_text()


def test_it_is_of_the_present_scene(store: NativeStore) -> None:
    """A restored state gives the recorded observation; the first actions give the recorded states.

    After a change of the scene: `make sample`. 1e-5: observations are float32, and other processors round elsewhere.
    """
    env = from_dict(EnvironmentConfig, dict(store.spec.environment)).build()
    for i in range(len(store)):
        played = store.read(i)
        for t in (0, len(played) // 2, len(played)):
            env.set_state(np.array(played.sim_state[t]))
            np.testing.assert_allclose(env.observe().achieved, played.achieved[t], atol=1e-5)
            np.testing.assert_allclose(env.observe().state, played.state[t], atol=1e-5)
        env.set_state(np.array(played.sim_state[0]))
        for action in played.action[:10]:
            env.step(action)
        np.testing.assert_allclose(env.observe().state, played.state[10], atol=1e-5)


def test_it_has_changes_and_mistakes(store: NativeStore) -> None:
    """Settled changes of several objects; open-loop plans, mistakes, slips and pauses."""
    table = RelabelIndex.of_store(store, SettlingConfig())
    assert sum(count > 0 for count in table.change_counts().values()) >= 3
    marks = {mark for i in range(len(store)) for skill in store.meta(i).skills for mark in skill.split(":")[1:]}
    assert {"open_loop", "mistake", "slip", "pause"} <= marks


def test_it_can_be_learned_from(store: NativeStore) -> None:
    """Batches with the goal images of the next settled moments."""
    config = DataConfig(cameras=("front", "wrist"), goal_cameras=("front",), val_fraction=0.0)
    batch = config.build(store, "train", 0).batch(0, np.arange(8))
    assert batch.goal_images["front"].shape == (8, 48, 64, 3)
    assert (batch.steps_to_goal >= 1).all()


def unneeded() -> Environment:
    raise AssertionError("a card needs no pictures")
