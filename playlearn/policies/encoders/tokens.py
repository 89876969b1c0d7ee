"""Image tokens as RT-1 makes them (Brohan et al. 2022), in a size that trains on a CPU.

A camera's convolutions are modulated by the goal (FiLM, Perez et al. 2018), so that features are conditioned on the
goal before they are pooled; then a few learned attention maps pool them into as many tokens (TokenLearner, Ryoo et al.
2021). The trunk reads the tokens of every camera instead of one vector of each.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.errors import UsageError
from playlearn.policies.encoders.base import Encoder, EncoderConfig, Tokens
from playlearn.policies.encoders.cameras import CamerasConfig, PerCamera, channels_last, pixels, random_shift
from playlearn.policies.encoders.goal_state import GoalStateEncoder
from playlearn.policies.encoders.objects import mlp
from playlearn.policies.spec import PolicySpec


@EncoderConfig.register_subclass("tokens")
@dataclass(frozen=True)
class TokensConfig(CamerasConfig):
    """A FiLM-conditioned CNN and TokenLearner for each camera.

    tokens: K, of an image (RT-1 has 8).
    channels: of each convolution.
    kernels: of each convolution.
    strides: of each convolution.

    Raises:
        UsageError: from `build`, where there is no layer or no token, or the layers' fields differ in length.
    """

    tokens: int = 4
    channels: tuple[int, ...] = (32, 32)
    kernels: tuple[int, ...] = (8, 3)
    strides: tuple[int, ...] = (4, 1)

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "TokensEncoder":
        self.check()
        lengths = {len(self.channels), len(self.kernels), len(self.strides)}
        if len(lengths) != 1 or not self.channels or self.tokens < 1:
            raise UsageError(
                f"encoder: tokens must be 1 or more (it is {self.tokens}), and channels, kernels and strides one each "
                f"a layer ({len(self.channels)}, {len(self.kernels)}, {len(self.strides)})"
            )
        return TokensEncoder(self, spec, width)


class TokensEncoder(Encoder):
    """The goal's token, then for each step K tokens a camera and one for the robot's own state."""

    goal_tokens = 1

    def __init__(self, config: TokensConfig, spec: PolicySpec, width: int) -> None:
        super().__init__()
        self.config = config
        self.step_tokens = config.tokens * len(config.cameras) + 1
        self.backbones = PerCamera({camera: ConvBackbone(config, config.hidden) for camera in config.cameras})
        seen = config.channels[-1] + 2
        self.out_proj = PerCamera({camera: nn.Linear(seen, width) for camera in config.cameras})
        self.proprio = mlp(len(spec.state_names), config.hidden, width)
        self.goal_flag = nn.Parameter(torch.randn(1 + len(config.goals), config.hidden) * 0.02)
        self.goal_backbone: nn.Module | None = None
        self.goal_encoder: nn.Module | None = None
        if "image" in config.goals:
            flat = nn.Linear(config.tokens * seen, config.hidden)
            self.goal_backbone = nn.Sequential(ConvBackbone(config, None), nn.Flatten(), flat, nn.ReLU())
        if "state" in config.goals:
            self.goal_encoder = GoalStateEncoder(spec, config.goal_names, config.hidden, config.hidden)
        self.goal_out = nn.Linear(config.hidden, width)

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        config, (batch, steps) = self.config, inputs.state.shape[:2]
        has_image = config.has_goal_image(inputs, generator)  # (B,)
        frames = {camera: inputs.images[camera] for camera in config.cameras}  # (B, T, h, w, 3)
        goal_frame: Tensor | None = None
        if config.goal_camera in inputs.goal_images:
            # shifted together with the present image of the same camera, or the goal would seem to lie elsewhere
            both = torch.cat([frames[config.goal_camera], inputs.goal_images[config.goal_camera].unsqueeze(1)], dim=1)
            moved = random_shift(both, config.shift, generator)
            frames[config.goal_camera], goal_frame = moved[:, :-1], moved[:, -1]
        goal = self._goal(inputs, goal_frame, keep, has_image)  # (B, W)
        condition = goal.repeat_interleave(steps, dim=0)  # (B T, W)
        tokens = []
        for camera, backbone in self.backbones.networks():
            images = frames[camera]
            if camera != config.goal_camera or goal_frame is None:
                images = random_shift(images, config.shift, generator)
            found = self.out_proj[camera](backbone(pixels(images.flatten(0, 1)), condition))  # (B T, K, D)
            tokens.append(found.unflatten(0, (batch, steps)))
        tokens.append(self.proprio(inputs.state).unsqueeze(2))
        return Tokens(self.goal_out(goal).unsqueeze(1), torch.cat(tokens, dim=2))

    def _goal(self, inputs: Inputs, frame: Tensor | None, keep: Tensor, has_image: Tensor) -> Tensor:
        """(B, hidden) the goal, from an image or a state, or that there is none."""
        flag = keep.long() if len(self.config.goals) == 1 else keep * (2 - has_image.long())
        goal = self.goal_flag[flag]
        if self.goal_backbone is not None and frame is not None:
            goal = goal + torch.where((keep & has_image)[:, None], self.goal_backbone(pixels(frame)), 0.0)
        if self.goal_encoder is not None:
            goal = goal + torch.where((keep & ~has_image)[:, None], self.goal_encoder(inputs.goal_achieved), 0.0)
        return goal


class ConvBackbone(nn.Module):
    """(B, 3, h, w) in [-1, 1] and a condition (B, W), or None, -> (B, K, width)."""

    def __init__(self, config: TokensConfig, condition: int | None) -> None:
        super().__init__()
        sizes = pairwise((3, *config.channels))
        self.layers = nn.ModuleList(
            channels_last(nn.Conv2d(inputs, outputs, kernel, stride, (kernel - stride + 1) // 2))
            for (inputs, outputs), kernel, stride in zip(sizes, config.kernels, config.strides, strict=True)
        )
        self.films = nn.ModuleList(_Film(condition, channels) for channels in config.channels if condition is not None)
        self.pool = TokenPool(config.channels[-1], config.tokens)

    def forward(self, images: Tensor, condition: Tensor | None = None) -> Tensor:
        for number, layer in enumerate(self.layers):
            images = layer(images)
            if condition is not None:
                images = self.films[number](images, condition)
            images = nn.functional.relu(images)
        tokens: Tensor = self.pool(images)
        return tokens


class _Film(nn.Module):
    """Scale and shift of every channel from a condition (B, W); the identity at first, as in RT-1."""

    def __init__(self, condition: int, channels: int) -> None:
        super().__init__()
        self.net = nn.Linear(condition, 2 * channels)
        nn.init.zeros_(self.net.weight)
        nn.init.zeros_(self.net.bias)

    def forward(self, maps: Tensor, condition: Tensor) -> Tensor:
        scale, shift = self.net(condition)[:, :, None, None].chunk(2, dim=1)  # (B, C, 1, 1)
        return torch.addcmul(shift, maps, 1 + scale)


class TokenPool(nn.Module):
    """(B, C, h, w) -> (B, K, C + 2): the mean under each of K attention maps, then its expected position, in [-1, 1].

    A map is normalized to zero mean and unit std before its softmax, as in `SpatialSoftmax`.
    """

    SHARPNESS = 4.0

    def __init__(self, channels: int, tokens: int) -> None:
        super().__init__()
        self.attend = nn.Conv2d(channels, tokens, 1, bias=False)
        self.sharpness = nn.Parameter(torch.full((tokens, 1), self.SHARPNESS))

    def forward(self, maps: Tensor) -> Tensor:
        height, width = maps.shape[2:]
        logits = self.attend(maps).flatten(2)  # (B, K, h w)
        std = logits.std(-1, keepdim=True) + 1e-4
        weights = ((logits - logits.mean(-1, keepdim=True)) / std * self.sharpness).softmax(-1)
        seen = torch.einsum("bkn,bcn->bkc", weights, maps.flatten(2))  # (B, K, C)
        at = weights.unflatten(-1, (height, width))
        x = (at.sum(-2) * torch.linspace(-1, 1, width, device=maps.device)).sum(-1, keepdim=True)
        y = (at.sum(-1) * torch.linspace(-1, 1, height, device=maps.device)).sum(-1, keepdim=True)
        return torch.cat([seen, x, y], dim=-1)
