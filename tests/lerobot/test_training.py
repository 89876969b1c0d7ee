"""Training on a LeRobot dataset gives the same policy as training on its store."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load_file

from playlearn.config import load_config
from playlearn.errors import UsageError
from playlearn.policies import Policy
from playlearn.quantity import Quantities
from playlearn.store import LeRobotStoreConfig, NativeStore, StoreSpec
from playlearn.store.lerobot.export import export_lerobot
from playlearn.training import TrainConfig, train
from tests.synthetic import make_episode, make_store
from tests.training.test_train import config

pytestmark = pytest.mark.filterwarnings("ignore")  # what LeRobot and the packages below it warn of is theirs to fix


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder for LeRobot's cache, instead of the user's."""
    import datasets

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", str(tmp_path / "cache"))


@pytest.mark.slow
def test_it_trains_the_same_policy(tmp_path: Path) -> None:
    store = make_store(tmp_path / "play", np.random.default_rng(0), 4, 200)
    export_lerobot(store, tmp_path / "exported")
    plain = replace(config(tmp_path / "play"), steps=3, val_batches=0)
    train(plain, tmp_path / "one")
    train(replace(plain, store=LeRobotStoreConfig(root=tmp_path / "exported")), tmp_path / "other")
    one, other = (load_file(tmp_path / run / "policy" / "policy.safetensors") for run in ("one", "other"))
    assert all(torch.equal(one[name], other[name]) for name in one)
    # What was trained on is written down, and can be read again.
    saved = load_config(TrainConfig, tmp_path / "other" / "config.yaml")
    assert saved.store == LeRobotStoreConfig(root=tmp_path / "exported")
    assert yaml.safe_load((tmp_path / "other" / "run.json").read_text())["store"]["episodes"] == 4


def test_actions_in_other_units_are_not_clipped(tmp_path: Path) -> None:
    """Nobody says what bounds them."""
    episodes = [make_episode(np.random.default_rng(seed), 100, seed=seed) for seed in range(3)]
    degrees = [replace(one, action=one.action * 90, expert_action=one.expert_action * 90 + 45) for one in episodes]
    degrees = [replace(one, meta=replace(one.meta, quantities=Quantities())) for one in degrees]
    store = NativeStore.create(tmp_path / "play", StoreSpec.of(degrees[0]))
    with store.writer() as writer:
        for episode in degrees:
            writer.append(episode)
    plain = config(tmp_path / "play")
    train(replace(plain, steps=2, data=replace(plain.data, val_fraction=0)), tmp_path / "run")
    policy = Policy.load(tmp_path / "run" / "policy")
    assert policy.spec.bounds == ()
    data = plain.data.build(store, "train", 0)
    # 45 on average: what is predicted is near there after no training to speak of, far outside [-1, 1].
    assert policy.act(data.batch(0, np.arange(8)), torch.Generator().manual_seed(0)).mean() > 10


@pytest.mark.slow
def test_a_missing_camera_is_named_with_those_that_exist(tmp_path: Path) -> None:
    make_store(tmp_path / "play", np.random.default_rng(0), 2, 60, {"top": (16, 24)})
    export_lerobot(NativeStore.open(tmp_path / "play"), tmp_path / "exported")
    (tmp_path / "exported" / "meta" / "playlearn").rename(tmp_path / "aside")
    wrong = config(tmp_path / "exported", "cnn")  # a folder of whatever kind will do
    with pytest.raises(
        UsageError, match=r"has no images of .* \(it has: top 16x24\); name its own: `--policy.encoder.cameras"
    ):
        train(wrong, tmp_path / "run")
