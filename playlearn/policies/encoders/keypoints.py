"""An image encoder with heatmaps that are supervised by each object's position in the image (keypoints).

One heatmap for each object is trained to peak at the pixel of that object's center, which a simulator that renders the
scene gives (privileged information); further heatmaps learn from the other losses alone. Each map pools the features
under it, its expected position and how peaked it is; the poses are estimated from these. A spatial softmax (Finn et al.
2016) has to localize the objects from the pose error alone: it takes ten times the updates.

The heatmaps are coarse, as convolutions over a whole image must be on a CPU. So each is followed by a glimpse (Mnih et
al. 2014): a small square of the image's own pixels around its expected position, which shows orientation and occlusion.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.errors import UsageError
from playlearn.layout import ObjectLayout
from playlearn.policies.encoders.base import EncoderConfig, Tokens
from playlearn.policies.encoders.cameras import channels_last
from playlearn.policies.encoders.image import ImageConfig, ImageEncoder
from playlearn.policies.spec import PolicySpec


@EncoderConfig.register_subclass("keypoints")
@dataclass(frozen=True)
class KeypointsConfig(ImageConfig):
    """A small CNN with heatmaps and glimpses.

    channels: of each convolution.
    kernels: of each convolution.
    strides: of each convolution.
    heatmaps: of each camera, those of the objects included.
    keypoints: weight of the heatmaps' loss, where the examples have keypoints; 0: no supervision of the maps.
    glimpse: side in pixels of the square around each heatmap's expected position; 0: no glimpses.
    glimpse_features: width of what each glimpse is encoded to.
    linear_estimate: see ImageConfig.
    """

    channels: tuple[int, ...] = (32, 32)
    kernels: tuple[int, ...] = (8, 3)
    strides: tuple[int, ...] = (4, 1)
    heatmaps: int = 8
    keypoints: float = 1.0
    glimpse: int = 16
    glimpse_features: int = 64
    linear_estimate: bool = True

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        return KeypointBackbone(self, channels, size)

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "KeypointsEncoder":
        objects = len(ObjectLayout(spec.achieved_names).places())
        if self.heatmaps < max(1, objects):
            raise UsageError(f"encoder.heatmaps is {self.heatmaps}: give one each of the {objects} objects, or more")
        if self.keypoints > 0 and self.shift > 0:
            raise UsageError("encoder.shift moves images and not their keypoints: set it, or encoder.keypoints, to 0")
        smallest = min(min(spec.cameras[camera]) for camera in self.cameras)
        if self.glimpse and not Glimpses.KERNEL <= self.glimpse <= smallest:
            raise UsageError(
                f"encoder.glimpse is {self.glimpse} pixels: give {Glimpses.KERNEL} to {smallest}, the least side of an "
                "image, or 0 for none"
            )
        self.check_build()
        return KeypointsEncoder(self, spec, width, fetch=fetch)


class KeypointsEncoder(ImageEncoder):
    """See the module's docstring, and `ImageEncoder`."""

    config: KeypointsConfig

    def run_backbone(self, backbone: nn.Module, images: Tensor) -> tuple[Tensor, Tensor | None]:
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


POSITION_SCALE = 4.0  # positions in an image are scaled to about the size of the features


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
        read = config.glimpse, config.heatmaps, config.glimpse_features
        self.glimpses = Glimpses(*read, blank.shape[1], size) if config.glimpse else None
        found = channels + 3 + (self.glimpses.features if self.glimpses else 0)  # under each heatmap
        self.project = nn.Linear(config.heatmaps * found, config.features)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        maps = self.convolutions(images)
        # with zero mean and unit std every map has a peak from the first update on, as in `SpatialSoftmax`
        logits = self.attend(maps).flatten(2)  # (B, K, h w)
        std, mean = torch.std_mean(logits, dim=-1, keepdim=True)
        logits = (logits - mean) * (self.sharpness / (std + 1e-3))
        total = logits.logsumexp(dim=-1, keepdim=True)  # how peaked the map is
        weights = (logits - total).exp()
        pooled = weights @ maps.flatten(2).transpose(1, 2)  # (B, K, C)
        positions = weights @ self.get_buffer("cells")  # (B, K, 2)
        found = [pooled, POSITION_SCALE * positions, total]
        if self.glimpses is not None:
            found.append(self.glimpses(images, positions.detach()))
        return self.project(torch.cat(found, dim=-1).flatten(1)), logits.unflatten(-1, maps.shape[2:])


class Glimpses(nn.Module):
    """Images (B, C, h, w) and K positions in each (B, K, 2), in [-1, 1], -> (B, K, features) of a square around each.

    The square is cropped at whole pixels and lies within the image; its center is one of the features. The convolution
    is shared, the layer behind it is each position's own.
    """

    CHANNELS, KERNEL, STRIDE = 32, 5, 2

    def __init__(self, side: int, count: int, features: int, channels: int, size: tuple[int, int]) -> None:
        """side: of a square in pixels. count: K. features: of a square, beside its center."""
        super().__init__()
        self.side, self.features = side, features + 2
        self.convolution = channels_last(nn.Conv2d(channels, self.CHANNELS, self.KERNEL, self.STRIDE))
        inputs = self.CHANNELS * ((self.side - self.KERNEL) // self.STRIDE + 1) ** 2
        weight = torch.randn(count, inputs, features) * (2 / inputs) ** 0.5  # He et al. 2015
        self.weight = nn.Parameter(weight)
        self.bias = nn.Parameter(torch.zeros(count, 1, features))
        height, width = size
        self.register_buffer("size", torch.tensor([width, height]), persistent=False)

    def forward(self, images: Tensor, positions: Tensor) -> Tensor:
        corners = self.corners(positions)
        maps = self.convolution(self.cut(images, corners).flatten(0, 1)).relu()
        maps = maps.flatten(1).unflatten(0, corners.shape[:2]).transpose(0, 1)  # (K, B, inputs)
        read = torch.baddbmm(self.bias, maps, self.weight).relu().transpose(0, 1)  # (B, K, glimpse_features)
        centers = 2 * (corners + self.side / 2) / self.get_buffer("size") - 1
        return torch.cat([read, POSITION_SCALE * centers], dim=-1)

    def corners(self, positions: Tensor) -> Tensor:
        """(B, K, 2) int64: the first column and row of each square."""
        size = self.get_buffer("size")
        first = ((positions + 1) / 2 * size - self.side / 2).round().long()
        return first.clamp(min=torch.zeros_like(size), max=size - self.side)

    def cut(self, images: Tensor, corners: Tensor) -> Tensor:
        """(B, K, C, side, side), channels last in memory."""
        batch, channels, height, width = images.shape
        along = torch.arange(self.side, device=images.device)
        rows, columns = corners[..., 1, None] + along, corners[..., 0, None] + along  # (B, K, side)
        first = torch.arange(batch, device=images.device).view(-1, 1, 1, 1) * (height * width)
        positions = first + rows[..., :, None] * width + columns[..., None, :]  # (B, K, side, side)
        pixels = images.permute(0, 2, 3, 1).reshape(-1, channels)
        # pixels picked by one flat index, as in `random_shift`
        return pixels.index_select(0, positions.flatten()).view(*positions.shape, channels).movedim(-1, 2)


def cell_centers(count: int) -> Tensor:
    """(count,) where the centers of so many cells lie in [-1, 1]."""
    return (2 * torch.arange(count) + 1) / count - 1


def heatmap_loss(logits: Tensor, points: Tensor) -> Tensor:
    """Cross entropy of (N, K, h, w) heatmaps and the first O <= K points (N, O, 2), x and y in [-1, 1]; scalar.

    A point is divided among the four cells around it, so that the expected position of its map can be exact. Points
    outside the image, NaN included, have no weight.
    """
    height, width = logits.shape[2:]
    logs = logits[:, : points.shape[1]].flatten(2).log_softmax(dim=-1)  # (N, O, h w)
    inside = (points.abs() <= 1).all(dim=-1)  # (N, O)
    sizes = points.new_tensor([width, height])
    at = ((points.nan_to_num() + 1) / 2 * sizes - 0.5).clamp(min=torch.zeros(2), max=sizes - 1 - 1e-3)
    low = at.floor()
    upper = at - low
    total = logs.new_zeros(inside.shape)
    for dx in (0, 1):
        for dy in (0, 1):
            corner = low + low.new_tensor([dx, dy])
            weight = (upper[..., 0] if dx else 1 - upper[..., 0]) * (upper[..., 1] if dy else 1 - upper[..., 1])
            cell = (corner[..., 1] * width + corner[..., 0]).long()
            total = total - weight * logs.gather(2, cell.unsqueeze(-1)).squeeze(-1)
    return torch.where(inside, total, 0.0).sum() / inside.sum().clamp(min=1)


def _cross_entropy(heatmaps: Mapping[str, Tensor], keypoints: Mapping[str, Tensor]) -> Tensor:
    """The sum over cameras: heatmaps camera -> (..., K, h, w), keypoints camera -> (..., O, 2)."""
    losses = [heatmap_loss(maps.flatten(0, -4), keypoints[camera].flatten(0, -3)) for camera, maps in heatmaps.items()]
    return torch.stack(losses).sum() if losses else torch.zeros(())
