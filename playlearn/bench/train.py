"""Updates a second of our diffusion policy beside LeRobot's DiffusionPolicy, on one batch held in memory.

Held equal: the batch; three images an example (front and wrist now, front in the goal: to LeRobot, whose policies
have no goals, a third camera), their size, state and action; one observation of history, the chunk, the length of
the noise schedule; the number of parameters, as nearly as the sizes allow (see the figure's name);
AdamW or Adam in float32; one thread. An update is forward, backward, clipping of the gradient and the optimizer's
step; its seconds are CPU time, so that other processes do not disturb either.

In LeRobot's favor: its images come as normalized floats (its processor makes them so before every update), ours as
they are stored; ours also keeps an average of its weights.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from playlearn.batch import Batch
from playlearn.bench.base import Figure, Size, measuring, rates
from playlearn.bench.envs import SEED, SIDE
from playlearn.policies import Policy, PolicyConfig, PolicySpec
from playlearn.policies.ema import averaged
from playlearn.policies.encoders import CNNConfig, TorchvisionConfig
from playlearn.policies.heads import DiffusionConfig

EXAMPLES = 8  # of an update; LeRobot's own default too
CHUNK = 16
STATE, ACHIEVED, ACTION = 10, 20, 7  # PlayTable's
CAMERAS, GOAL_CAMERA = ("front", "wrist"), "front"


def training(size: Size) -> Iterator[Figure]:
    """The same vision network in both (ResNet-18, group norm); then our own in ours, its denoiser widened to match."""
    resnet = TorchvisionConfig(cameras=CAMERAS, goal_camera=GOAL_CAMERA, fusion="late")
    cnn = CNNConfig(cameras=CAMERAS, goal_camera=GOAL_CAMERA, fusion="late")
    resnets = PolicyConfig(encoder=resnet, head=DiffusionConfig(noise_draws=1), chunk=CHUNK)
    wide = PolicyConfig(encoder=cnn, head=DiffusionConfig(width=1280), chunk=CHUNK)
    yield _figure("ResNet-18 in both", build_policy(resnets), _peer((128, 256, 512), 128), size)
    yield _figure("our CNN, ResNet-18", build_policy(wide), _peer((64, 128, 256), 64), size)


def _figure(what: str, ours: Policy, peer: Any, size: Size) -> Figure:
    measuring(f"train, {what}")
    updates, examples = max(1, size.steps // 50), min(EXAMPLES, size.steps)
    measured = rates(
        {
            "ours": partial(_turn, an_update(ours, examples), updates),
            "peer": partial(_turn, _peer_update(peer, examples), updates),
        },
        size.rounds,
    )
    parameters = [sum(p.numel() for p in policy.parameters()) / 1e6 for policy in (ours, peer)]
    return Figure.beside(
        f"train, {what}, {parameters[0]:.1f} M and {parameters[1]:.1f} M parameters",
        "updates/s",
        measured,
        "LeRobot's DiffusionPolicy",
    )


def _turn(update: Callable[[], None], updates: int) -> tuple[int, float]:
    began = time.process_time()
    for _ in range(updates):
        update()
    return updates, time.process_time() - began


def build_policy(config: PolicyConfig) -> Policy:
    """A policy with PlayTable's dimensions and two cameras."""

    def names(kind: str, count: int) -> tuple[str, ...]:
        return tuple(f"{kind}.{i}" for i in range(count))

    spec = PolicySpec(
        names("state", STATE),
        names("achieved", ACHIEVED),
        names("action", ACTION),
        fps=20.0,
        cameras=dict.fromkeys(CAMERAS, (SIDE, SIDE)),
    )
    return config.build(spec, None, SEED)


def an_update(policy: Policy, examples: int) -> Callable[[], None]:
    """As `playlearn train` makes one, on so many examples held in memory."""
    optimizer = torch.optim.AdamW(policy.parameters(), fused=True)
    ema, generator = averaged(policy, 0.999), torch.Generator().manual_seed(SEED)
    images = dict.fromkeys(CAMERAS, torch.randint(256, (examples, 1, SIDE, SIDE, 3), dtype=torch.uint8))
    batch = Batch(
        state=torch.randn(examples, 1, STATE),
        achieved=torch.randn(examples, 1, ACHIEVED),
        images=images,
        history_mask=torch.ones(examples, 1, dtype=torch.bool),
        goal_achieved=torch.randn(examples, ACHIEVED),
        goal_proprio=torch.randn(examples, STATE),
        goal_images={GOAL_CAMERA: images[GOAL_CAMERA][:, 0]},
        action=torch.rand(examples, policy.config.chunk, ACTION) * 2 - 1,
        action_mask=torch.ones(examples, policy.config.chunk, dtype=torch.bool),
        steps_to_goal=torch.ones(examples, dtype=torch.int64),
    )

    def update() -> None:
        _learn(policy, optimizer, policy(batch, generator)[0])
        ema.update_parameters(policy)

    return update


def _peer(down_dims: tuple[int, ...], embedding: int) -> Any:
    """LeRobot's policy at its defaults but for sizes: one ResNet-18 for all cameras, group norm, no download."""
    # Slow to import.
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig as PeerConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    with torch.random.fork_rng(devices=[]):
        torch.random.manual_seed(SEED)
        return DiffusionPolicy(
            PeerConfig(
                n_obs_steps=1,
                horizon=CHUNK,
                n_action_steps=CHUNK // 2,
                input_features={
                    "observation.state": PolicyFeature(FeatureType.STATE, (STATE,)),
                    **{key: PolicyFeature(FeatureType.VISUAL, (3, SIDE, SIDE)) for key in _peer_images()},
                },
                output_features={"action": PolicyFeature(FeatureType.ACTION, (ACTION,))},
                pretrained_backbone_weights=None,
                use_group_norm=True,
                use_separate_rgb_encoder_per_camera=False,
                down_dims=down_dims,
                diffusion_step_embed_dim=embedding,
                device="cpu",
            )
        )


def _peer_images() -> tuple[str, ...]:
    return *(f"observation.images.{camera}" for camera in CAMERAS), f"observation.images.goal_{GOAL_CAMERA}"


def _peer_update(policy: Any, examples: int) -> Callable[[], None]:
    """As `lerobot-train` makes one."""
    preset = policy.config.get_optimizer_preset()
    optimizer = preset.build(policy.get_optim_params())
    batch = {
        "observation.state": torch.randn(examples, 1, STATE),
        "action": torch.rand(examples, CHUNK, ACTION) * 2 - 1,
        "action_is_pad": torch.zeros(examples, CHUNK, dtype=torch.bool),
        **{key: torch.randn(examples, 1, 3, SIDE, SIDE) for key in _peer_images()},
    }
    policy.train()

    def update() -> None:
        _learn(policy, optimizer, policy(batch)[0])

    return update


def _learn(policy: nn.Module, optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
    optimizer.step()
