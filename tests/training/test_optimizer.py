"""What an update does beside following the gradient: weight decay, clipping, averaging."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from playlearn.config import from_dict
from playlearn.policies.ema import averaged
from playlearn.policies.heads.diffusion import DiffusionHead
from playlearn.training import TrainConfig, train
from tests.policies.parts import small
from tests.synthetic import make_store

LR = 1e-2


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("optimizer") / "play"
    make_store(path, np.random.default_rng(0), episodes=4, steps=60)
    return path


def trained(play: Path, out: Path, steps: int = 1, **options: Any) -> dict[str, Tensor]:
    """The weights after `steps` updates, without warm-up and averaging unless asked for."""
    fields: dict[str, Any] = {
        "store": str(play),
        "policy": {
            "encoder": small("state"),
            "trunk": small("transformer"),
            "head": small("diffusion"),
            "chunk": 4,
        },
        "batch_size": 8,
        "steps": steps,
        "lr": LR,
        "warmup": 0,
        "weight_decay": 0.0,
        "grad_clip": 1e9,
        "ema_decay": 0.0,
        "val_batches": 0,
        "cpu": True,
    }
    train(from_dict(TrainConfig, fields | options), out)
    return {
        name: value for name, value in load_file(out / "policy" / "policy.safetensors").items() if "normal" not in name
    }


@pytest.mark.slow
def test_weight_decay_shrinks_matrices_and_nothing_else(play: Path, tmp_path: Path) -> None:
    """A bias or the scale of a norm is no weight on an input: pulled to zero it would only be wrong."""
    plain, decayed = trained(play, tmp_path / "plain"), trained(play, tmp_path / "decayed", weight_decay=0.5)
    kept = {name for name in plain if torch.equal(plain[name], decayed[name])}
    vectors = {name for name, value in plain.items() if value.ndim <= 1}
    assert len(vectors) > 10
    assert {name for name in plain if name.endswith(("bias", "norm.weight", "layernorm.weight"))} <= vectors
    assert vectors <= kept
    matrices = {name for name, value in plain.items() if value.is_floating_point() and value.ndim > 1}
    assert {name for name in matrices - kept if name.startswith("head.")}
    for name in matrices - kept:
        assert float(decayed[name].norm()) < float(plain[name].norm())


def test_a_gradient_is_clipped_to_the_norm_that_is_asked_for(play: Path, tmp_path: Path) -> None:
    """Adam divides by the gradient's own size, save where that is far below its epsilon of 1e-8."""
    free, clipped = trained(play, tmp_path / "free"), trained(play, tmp_path / "clipped", grad_clip=1e-13)
    begun = trained(play, tmp_path / "begun", lr=1e-30)

    def moved(weights: dict[str, Tensor]) -> float:
        return max(
            float((weights[name] - begun[name]).abs().max()) for name in begun if begun[name].is_floating_point()
        )

    assert moved(free) == pytest.approx(LR, rel=0.05)
    assert moved(clipped) < LR / 1000


def test_an_average_warms_up_and_then_forgets_at_its_decay() -> None:
    """Of n updates the decay is min(decay, (1 + n) / (10 + n)): 2/11, 3/12, then 0.25."""
    model = nn.Linear(1, 1, bias=False)
    average = averaged(model, 0.25)
    expected = 0.0
    for n, value in enumerate((3.0, -1.0, 4.0, 1.0, 5.0)):
        nn.init.constant_(model.weight, value)
        average.update_parameters(model)
        decay = min(0.25, (1 + n) / (10 + n))
        expected = value if n == 0 else decay * expected + (1 - decay) * value
        assert average.module.weight.item() == pytest.approx(expected)


def test_what_warms_up_is_given_the_updates_made(play: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss of a head hears the number of each update: 0, 1, 2; held-out losses are those after any warm-up."""
    heard: list[int | None] = []
    plain = DiffusionHead.loss

    def loss(head: Any, features: Tensor, chunk: Tensor, mask: Tensor, generator: Any, updates: Any = None) -> Any:
        heard.append(updates)
        return plain(head, features, chunk, mask, generator, updates)

    monkeypatch.setattr(DiffusionHead, "loss", loss)
    trained(play, tmp_path / "three", steps=3)
    assert heard == [0, 1, 2]
