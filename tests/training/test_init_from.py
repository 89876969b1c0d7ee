"""Laws of training that starts from another policy, or trains a part of one."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from playlearn.config import from_dict
from playlearn.errors import UsageError
from playlearn.policies import Policy
from playlearn.training import TrainConfig, train
from tests.synthetic import make_store

torch.set_num_threads(1)
IMAGE_ENCODER = ("encoder.front.*", "encoder.others.*", "encoder.estimate.*")
SEEING = {
    "type": "cnn",
    "hidden": 16,
    "fusion": "late",
    "channels": [4],
    "kernels": [4],
    "strides": [2],
    "features": 8,
    "state_supervision": 1.0,
    "use_estimated_state": True,
    "feed_cameras": [],
}


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("init") / "play"
    make_store(path, np.random.default_rng(0), episodes=3, steps=60, cameras=("front", "wrist"))
    return path


@pytest.fixture(scope="module")
def started(play: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a policy of states."""
    out = tmp_path_factory.mktemp("init") / "state"
    train(config(play, {"type": "state", "hidden": 16}), out)
    return out


def config(play: Path, encoder: dict[str, Any], **more: Any) -> TrainConfig:
    trunk = {"type": "transformer", "width": 16, "layers": 1, "heads": 2}
    policy = {"encoder": encoder, "trunk": trunk, "head": {"type": "deterministic"}, "chunk": 4}
    fields = {"store": str(play), "policy": policy, "batch_size": 8, "steps": 3, "warmup": 1, "cpu": True}
    return from_dict(TrainConfig, fields | {"val_batches": 0, "ema_decay": 0.0} | more)


def weights(run: Path) -> dict[str, Tensor]:
    return load_file(run / "policy" / "policy.safetensors")


def test_eyes_are_learned_for_a_policy_of_states(play: Path, started: Path, tmp_path: Path) -> None:
    """Trunk and head are the state policy's, bit for bit; only the image encoder was trained."""
    encoder = config(play, SEEING, init_from=str(started), trainable=IMAGE_ENCODER)
    train(encoder, tmp_path / "encoder")
    lent, seeing = weights(started), weights(tmp_path / "encoder")
    for name, value in lent.items():
        assert torch.equal(seeing[name], value), name
    assert all(
        name.startswith(tuple(pattern[:-1] for pattern in IMAGE_ENCODER)) for name in seeing.keys() - lent.keys()
    )
    train(replace(encoder, steps=4), tmp_path / "longer")
    moved = weights(tmp_path / "longer")
    assert any(not torch.equal(moved[name], seeing[name]) for name in seeing)
    # where its estimates are right it does what the state policy does
    policy, state = Policy.load(tmp_path / "encoder" / "policy"), Policy.load(started / "policy")
    batch = encoder.resolved().data.build(_store(play), "train", 0).batch(0, np.arange(5))
    normal = state.normalized(batch)
    policy.encoder.estimate.forward = lambda *_: normal.achieved  # type: ignore[union-attr, method-assign]
    policy.encoder.estimate.wanted.forward = lambda _: normal.goal_achieved  # type: ignore[union-attr]
    draws = torch.Generator().manual_seed(0)
    torch.testing.assert_close(policy.act(batch, draws), state.act(batch, draws))


def test_all_goes_on_from_there(play: Path, started: Path, tmp_path: Path) -> None:
    """Without `learn` the whole policy is trained on, its normalizer stays."""
    train(config(play, SEEING, init_from=str(started)), tmp_path / "all")
    lent, after = weights(started), weights(tmp_path / "all")
    assert all(torch.equal(after[name], lent[name]) for name in lent if name.startswith("normalizer"))
    assert not all(torch.equal(after[name], lent[name]) for name in lent if name.startswith("head"))


def test_what_does_not_fit_is_refused(play: Path, started: Path, tmp_path: Path) -> None:
    for encoder in (
        SEEING | {"use_estimated_state": False, "feed_cameras": None},
        SEEING | {"hidden": 8},
        {"type": "state", "hidden": 8},
    ):
        with pytest.raises(
            UsageError,
            match=r"init_from: the policy of .* has another .*: copy the `policy` block of that run; to start an image",
        ):
            train(config(play, encoder, init_from=str(started)), tmp_path / "run")
    with pytest.raises(UsageError, match=r"trainable: 'nothing' matches no parameter; there are encoder\.estimate"):
        train(config(play, SEEING, trainable=["nothing"]), tmp_path / "run")


def _store(play: Path) -> Any:
    from playlearn.store import open_store

    return open_store(play)
