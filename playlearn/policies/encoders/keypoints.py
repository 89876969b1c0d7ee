"""An image encoder that is shown where in a picture each object is, while it learns to tell where things are.

A heatmap an object is taught the pixel at which a camera sees that object's center, which a simulator that draws
scenes knows (privileged information); further heatmaps find for themselves what else matters. Under each map the
features, the place that it points at and how sure it is are pooled, and the pose is read off these. A spatial softmax
(Finn et al. 2016) has to find the objects by the pose's error alone: it takes ten times the updates.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.errors import UsageError
from playlearn.policies.encoders.base import EncoderConfig, Tokens
from playlearn.policies.encoders.cameras import channels_last
from playlearn.policies.encoders.image import ImageConfig, ImageEncoder
from playlearn.policies.inputs import Inputs, PolicySpec, placed_objects


@EncoderConfig.register_subclass("keypoints")
@dataclass(frozen=True)
class KeypointsConfig(ImageConfig):
    """channels, kernels, strides: of the convolutions, one of each a layer.
    heatmaps: of a camera, the objects' among them.
    keypoints: weight of the heatmaps' loss, where the examples bring keypoints; 0: the maps find everything themselves.
    """

    channels: tuple[int, ...] = (32, 32)
    kernels: tuple[int, ...] = (8, 3)
    strides: tuple[int, ...] = (4, 1)
    heatmaps: int = 8
    keypoints: float = 1.0
    linear_estimate: bool = True

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        return KeypointBackbone(self, channels, size)

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "KeypointsEncoder":
        objects = len(placed_objects(spec.achieved_names))
        if self.heatmaps < max(1, objects):
            raise UsageError(f"encoder.heatmaps is {self.heatmaps}: give one each of the {objects} objects, or more")
        if self.keypoints > 0 and self.shift > 0:
            raise UsageError("encoder.shift moves images and not their keypoints: set it, or encoder.keypoints, to 0")
        self.check_build()
        return KeypointsEncoder(self, spec, width, fetch=fetch)


class KeypointsEncoder(ImageEncoder):
    """See the module's docstring, and `ImageEncoder`."""

    config: KeypointsConfig

    def look(self, backbone: nn.Module, images: Tensor) -> tuple[Tensor, Tensor | None]:
        features, heatmaps = backbone(images)
        return features, heatmaps

    def auxiliary(self, tokens: Tokens, inputs: Inputs) -> dict[str, Tensor]:
        losses = super().auxiliary(tokens, inputs)
        if self.config.keypoints > 0 and inputs.keypoints:
            losses["keypoints"] = self.config.keypoints * (
                _cross_entropy(tokens.heatmaps, inputs.keypoints)
                + _cross_entropy(tokens.goal_heatmaps, inputs.goal_keypoints)
            )
        return losses


class KeypointBackbone(nn.Module):
    """(B, C, h, w) in [-1, 1] -> (B, features) and the heatmaps (B, K, h', w') as logits."""

    SHARPNESS = 4.0

    def __init__(self, config: KeypointsConfig, channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        blank = torch.zeros(1, channels, *size)
        for out, kernel, stride in zip(config.channels, config.kernels, config.strides, strict=True):
            layers += [nn.Conv2d(channels, out, kernel, stride, (kernel - stride + 1) // 2), nn.ReLU()]
            channels = out
        self.convolutions = channels_last(nn.Sequential(*layers))
        self.attend = nn.Conv2d(channels, config.heatmaps, 1)
        with torch.no_grad():
            height, width = self.convolutions(blank).shape[2:]
        y, x = torch.meshgrid(cell_centers(height), cell_centers(width), indexing="ij")
        self.register_buffer("cells", torch.stack([x.flatten(), y.flatten()], dim=1), persistent=False)  # (h w, 2)
        self.sharpness = nn.Parameter(torch.full((config.heatmaps, 1), self.SHARPNESS))
        self.project = nn.Linear(config.heatmaps * (channels + 3), config.features)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        maps = self.convolutions(images)
        # at zero mean and unit spread every map points somewhere from the first update on, as in `SpatialSoftmax`
        logits = self.attend(maps).flatten(2)  # (B, K, h w)
        spread, mean = torch.std_mean(logits, dim=-1, keepdim=True)
        logits = (logits - mean) * (self.sharpness / (spread + 1e-3))
        total = logits.logsumexp(dim=-1, keepdim=True)  # how much one place stands out
        weights = (logits - total).exp()
        seen = weights @ maps.flatten(2).transpose(1, 2)  # (B, K, C)
        pooled = torch.cat([seen, 4 * (weights @ self.get_buffer("cells")), total], dim=-1)
        return self.project(pooled.flatten(1)), logits.unflatten(-1, maps.shape[2:])


def cell_centers(count: int) -> Tensor:
    """(count,) where the centers of so many cells lie in [-1, 1]."""
    return (2 * torch.arange(count) + 1) / count - 1


def heatmap_loss(logits: Tensor, points: Tensor) -> Tensor:
    """Cross entropy of (N, K, h, w) heatmaps and the first O <= K points (N, O, 2), x and y in [-1, 1]; scalar.

    A point is shared out among the four cells around it, so that the mean place under its map can be exact. What
    lies outside the image, NaN included, counts for nothing.
    """
    height, width = logits.shape[2:]
    logs = logits[:, : points.shape[1]].flatten(2).log_softmax(dim=-1)  # (N, O, h w)
    inside = (points.abs() <= 1).all(dim=-1)  # (N, O)
    sizes = points.new_tensor([width, height])
    at = ((points.nan_to_num() + 1) / 2 * sizes - 0.5).clamp(min=torch.zeros(2), max=sizes - 1 - 1e-3)
    low = at.floor()
    high_share = at - low
    total = logs.new_zeros(inside.shape)
    for dx in (0, 1):
        for dy in (0, 1):
            corner = low + low.new_tensor([dx, dy])
            share = (high_share[..., 0] if dx else 1 - high_share[..., 0]) * (
                high_share[..., 1] if dy else 1 - high_share[..., 1]
            )
            cell = (corner[..., 1] * width + corner[..., 0]).long()
            total = total - share * logs.gather(2, cell.unsqueeze(-1)).squeeze(-1)
    return torch.where(inside, total, 0.0).sum() / inside.sum().clamp(min=1)


def _cross_entropy(heatmaps: Mapping[str, Tensor], keypoints: Mapping[str, Tensor]) -> Tensor:
    """The sum over cameras: heatmaps camera -> (..., K, h, w), keypoints camera -> (..., O, 2)."""
    losses = [heatmap_loss(maps.flatten(0, -4), keypoints[camera].flatten(0, -3)) for camera, maps in heatmaps.items()]
    return torch.stack(losses).sum() if losses else torch.zeros(())
