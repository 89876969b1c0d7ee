"""Small policies of every registered kind, and inputs for them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from playlearn.batch import Statistics
from playlearn.config import from_dict
from playlearn.policies import EncoderConfig, HeadConfig, Policy, PolicyConfig, PolicySpec, TrunkConfig
from playlearn.policies.heads import (
    AutoregressiveConfig,
    DiffusionConfig,
    FastConfig,
    FlowConfig,
    Head,
    LogisticConfig,
    MixtureConfig,
)
from playlearn.quantity import Quantities

torch.set_num_threads(1)

SPEC = PolicySpec(
    state_names=("eef.x", "eef.y", "gripper"),
    achieved_names=("red.x", "red.y", "drawer", "lamp"),
    action_names=("dx", "dy", "gripper"),
    fps=20.0,
    cameras={"front": (16, 16), "wrist": (16, 16)},
    quantities=Quantities(action_bounds=((-1.0, 1.0),) * 3),
)
S, G, A, H = 3, 4, 3, 4

# Only what makes a kind quick; a kind that is not named here is tested with its defaults.
SMALL: dict[str, dict[str, Any]] = {
    "cnn": {"channels": [8, 8], "kernels": [3, 3], "strides": [2, 2], "features": 16, "hidden": 16},
    "keypoints": {
        "channels": [8, 8],
        "kernels": [3, 3],
        "strides": [2, 2],
        "features": 16,
        "hidden": 16,
        "heatmaps": 3,
    },
    "hand": {"channels": 8, "features": 16, "hidden": 16},
    "tokens": {"channels": [8, 8], "kernels": [3, 3], "strides": [2, 2], "tokens": 2, "hidden": 16},
    "transformers": {
        "name": "resnet",
        "options": {"embedding_size": 8, "hidden_sizes": [8, 16], "depths": [1, 1], "layer_type": "basic"},
        "features": 16,
        "hidden": 16,
    },
    "torchvision": {"name": "shufflenet_v2_x0_5", "features": 16, "hidden": 16},
    "diffusion": {"width": 32, "blocks": 2, "sample_steps": 3},
    "autoregressive": {"bins": 16, "width": 16, "layers": 2, "heads": 2, "label_smoothing_bins": 0.0},
    "cvae": {"hidden": 16, "latent": 4},
    "fast": {"vocabulary": 300, "width": 16, "layers": 1, "heads": 2},
    "flow": {"width": 32, "blocks": 2, "sample_steps": 3},
    "gaussian": {"hidden": 16},
    "latent_plan": {"hidden": 16, "latent": 4},
    "logistic": {"components": 3, "bins": 16, "hidden": 16},
    "mog": {"components": 3, "hidden": 16},
    "transformer": {"width": 32, "layers": 2},
    "lstm": {"width": 32, "layers": 1},
    "mlp": {"width": 32, "hidden": 32},
}
ENCODERS = sorted(EncoderConfig.get_known_choices())
TRUNKS = sorted(TrunkConfig.get_known_choices())
HEADS = sorted(HeadConfig.get_known_choices())


@dataclass(frozen=True, eq=False)
class Examples:
    """The fields of a Batch that a policy reads."""

    state: torch.Tensor
    achieved: torch.Tensor
    history_mask: torch.Tensor
    goal_achieved: torch.Tensor
    goal_proprio: torch.Tensor
    action: torch.Tensor
    action_mask: torch.Tensor
    images: Mapping[str, torch.Tensor] = field(default_factory=dict)
    goal_images: Mapping[str, torch.Tensor] = field(default_factory=dict)
    keypoints: Mapping[str, torch.Tensor] = field(default_factory=dict)
    goal_keypoints: Mapping[str, torch.Tensor] = field(default_factory=dict)
    events: Mapping[str, torch.Tensor] = field(default_factory=dict)


def small(kind: str, **more: Any) -> dict[str, Any]:
    return {"type": kind, **SMALL.get(kind, {}), **more}


def policy(
    encoder: str = "state",
    trunk: str = "mlp",
    head: str = "deterministic",
    *,
    seed: int = 0,
    history: int = 1,
    encoder_options: Mapping[str, Any] | None = None,
    head_options: Mapping[str, Any] | None = None,
    goal_dropout: float = 0.1,
) -> Policy:
    """A fresh one whose normalizer is not the identity."""
    config = from_dict(
        PolicyConfig,
        {
            "encoder": small(encoder, **(encoder_options or {})),
            "trunk": small(trunk),
            "head": small(head, **(head_options or {})),
            "history": history,
            "chunk": H,
            "goal_dropout": goal_dropout,
        },
    )
    return config.build(SPEC, spreads(), seed)


def spreads() -> dict[str, Statistics]:
    rng = np.random.default_rng(1)
    return {
        name: Statistics(rng.normal(size=n) * 0.1, rng.uniform(0.2, 0.5, n))
        for name, n in (("state", S), ("achieved", G), ("action", A))
    }


def examples(count: int = 5, history: int = 1, seed: int = 0) -> Examples:
    rng = torch.Generator().manual_seed(seed)

    def numbers(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=rng)

    def frames(*shape: int) -> torch.Tensor:
        return torch.randint(0, 256, (*shape, 16, 16, 3), dtype=torch.uint8, generator=rng)

    return Examples(
        state=numbers(count, history, S),
        achieved=numbers(count, history, G),
        history_mask=torch.ones(count, history, dtype=torch.bool),
        goal_achieved=numbers(count, G),
        action=numbers(count, H, A).clamp(-1, 1),
        action_mask=torch.ones(count, H, dtype=torch.bool),
        images={"front": frames(count, history), "wrist": frames(count, history)},
        goal_images={"front": frames(count)},
        goal_proprio=numbers(count, S),
        events={
            "grasp": numbers(count, S).where(torch.arange(count)[:, None] % 3 > 0, torch.nan),
            "settled": numbers(count, S),
        },
    )


def take(batch: Examples, rows: slice) -> Examples:
    def cut(value: Any) -> Any:
        return {name: one[rows] for name, one in value.items()} if isinstance(value, Mapping) else value[rows]

    return Examples(**{name: cut(value) for name, value in vars(batch).items()})


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


# What learns two modes within a second, and is held closely to it in test_heads.py.
MULTIMODAL = {
    "diffusion": DiffusionConfig(width=64, blocks=2, train_steps=50, sample_steps=10, clip=1.2),
    "diffusion of noise": DiffusionConfig(
        width=64, blocks=2, train_steps=50, prediction="epsilon", sample_steps=10, clip=1.2
    ),
    "diffusion of v": DiffusionConfig(
        width=64, blocks=2, train_steps=50, prediction="v_prediction", sample_steps=10, clip=1.2
    ),
    "flow": FlowConfig(width=64, blocks=2, sample_steps=20),
    "mixture": MixtureConfig(components=3, hidden=32),
    "logistic": LogisticConfig(components=3, bins=32, hidden=32),
    "autoregressive": AutoregressiveConfig(bins=32, width=32, layers=1, label_smoothing_bins=0.0),
    "fast": FastConfig(vocabulary=300, width=32, layers=1),
    "autoregressive, per step": AutoregressiveConfig(
        bins=32, order="step", width=32, layers=1, label_smoothing_bins=0.0
    ),
}


def train_on_two_modes(
    config: HeadConfig, updates: int, *, steps: int = 2, positive: float = 0.75, decay: bool = False
) -> Head:
    """A head trained on whole chunks (steps, 1) of +1 (a fraction `positive` of them) and of -1.

    decay: of the learning rate to 0, so that the samples do not depend on the last few examples.
    """
    torch.manual_seed(0)
    head = config.build(2, steps, 1)
    head.fit_action_statistics(torch.tensor([1.0, -1.0]).view(2, 1, 1).expand(2, steps, 1))
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3, fused=True)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0 if decay else 1.0, updates)
    rng = generator(1)
    for update in range(updates):
        sign = torch.where(torch.rand(64, generator=rng) < positive, 1.0, -1.0)
        chunk = sign.view(64, 1, 1).expand(64, steps, 1)
        optimizer.zero_grad()
        loss, _ = head.loss(torch.ones(64, 2), chunk, torch.ones(64, steps, dtype=torch.bool), rng, update)
        loss.backward()
        optimizer.step()
        schedule.step()
    return head
