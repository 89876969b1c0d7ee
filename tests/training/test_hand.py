"""Training an encoder by the hand alone, and a policy from it: two runs, as a user starts them."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from playlearn.config import from_dict
from playlearn.errors import StoreError
from playlearn.policies import Policy
from playlearn.store import NativeStore
from playlearn.training import TrainConfig, train
from tests.synthetic import make_store

ACTING = ["encoder.events.*", "encoder.fed.*", "encoder.robot.*", "encoder.goal_flag", "trunk.*", "head.*"]


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight episodes in which the hand grasps, carries and lets go six times."""
    folder = tmp_path_factory.mktemp("play")
    plain = make_store(folder / "plain", np.random.default_rng(0), 8, 180, {"front": (16, 24), "wrist": (16, 16)})
    store = NativeStore.create(folder / "store", plain.spec)
    t, rng = np.arange(181), np.random.default_rng(1)
    with store.writer() as writer:
        for i in range(len(plain)):
            episode = plain.read(i)
            state = np.array(episode.state)
            for k in range(3):
                state[:, k] = np.interp(t, np.arange(0, 181, 15), rng.uniform(-0.3, 0.3, 13))
            state[:, 3] = np.where((t % 30 >= 8) & (t % 30 < 23), 0.0, 0.08)
            writer.append(dataclasses.replace(episode, state=state))
    return store.path


def config(play: Path, **fields: Any) -> TrainConfig:
    policy = {
        "encoder": {"type": "hand", "hidden": 8, "features": 8, "channels": 8, "shift": 2},
        "trunk": {"type": "mlp", "width": 16, "hidden": 16},
        "chunk": 4,
    }
    data = {"settling": {"source": "robot"}, "val_fraction": 0.3}
    steps = {"steps": 4, "batch_size": 8, "val_batches": 1, "val_every": 4, "checkpoint_every": 4, "cpu": True}
    return from_dict(
        TrainConfig, {"store": str(play), "blind": True, "policy": policy, "data": data, **steps, **fields}
    )


def test_a_policy_is_trained_from_the_encoder_of_another_run(play: Path, tmp_path: Path) -> None:
    learned = {"steps": 30, "val_every": 30, "checkpoint_every": 30, "lr": 3e-3, "warmup": 5, "ema_decay": 0.5}
    train(config(play, trainable=["encoder.estimate.*"], **learned), tmp_path / "encoder")
    train(config(play, trainable=ACTING, init_from=str(tmp_path / "encoder")), tmp_path / "policy")
    encoder, policy = (Policy.load(tmp_path / name / "policy") for name in ("encoder", "policy"))
    same = {name: torch.equal(one, policy.state_dict()[name]) for name, one in encoder.state_dict().items()}
    assert all(equal for name, equal in same.items() if name.startswith("encoder.estimate."))
    assert not all(equal for name, equal in same.items() if name.startswith("trunk."))
    assert float(encoder.encoder.get_buffer("estimate.projection").abs().sum()) > 0
    for name in ("encoder", "policy"):
        record = json.loads((tmp_path / name / "run.json").read_text())
        assert record["privileged"] == {"training": [], "relabeling": [], "goal": []}
        picture = Image.open(io.BytesIO((tmp_path / name / "events.png").read_bytes()))
        assert picture.size == (4 * 2 * 3 * 24, 2 * 3 * 16), "two rows of four, observation and goal, enlarged"


def test_without_grasps_it_is_said_what_is_missing(play: Path, tmp_path: Path) -> None:
    few = config(play, data={"settling": {"source": "robot"}, "val_fraction": 0.6})
    with pytest.raises(StoreError, match=r"\d+ grasps with a settled moment after them; where the front camera"):
        train(few, tmp_path / "run")
