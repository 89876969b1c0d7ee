"""How existing vision networks become backbones: their input scale, no batch norm, frozen or not."""

from typing import Self

import torch
from torch import Tensor, nn

IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Scale(nn.Module):
    """Images in [-1, 1] to the mean and std that a network was trained with; those are of colors in 0 to 1."""

    def __init__(self, channels: int, mean: tuple[float, ...], std: tuple[float, ...]) -> None:
        super().__init__()
        repeat = channels // 3
        center, scale = 2 * torch.tensor(mean) - 1, 2 * torch.tensor(std)
        self.register_buffer("mean", center.repeat(repeat)[:, None, None], persistent=False)
        self.register_buffer("std", scale.repeat(repeat)[:, None, None], persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return (images - self.get_buffer("mean")) / self.get_buffer("std")


class Frozen(nn.Module):
    """A network that is not trained: no gradient, no dropout, no update of statistics."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body.requires_grad_(False).eval()

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        out: Tensor = self.body(images)
        return out

    def train(self, mode: bool = True) -> Self:
        super().train(mode)
        self.body.eval()
        return self


def replace_batch_norm(module: nn.Module, *, pretrained: bool) -> None:
    """Group norm from scratch, frozen statistics where pretrained: examples of a batch stay independent."""
    from torchvision.ops import FrozenBatchNorm2d

    for name, child in module.named_children():
        if not isinstance(child, nn.BatchNorm2d):
            replace_batch_norm(child, pretrained=pretrained)
            continue
        features = child.num_features
        if pretrained:
            norm: nn.Module = FrozenBatchNorm2d(features, eps=child.eps)
            norm.load_state_dict(child.state_dict(), strict=False)
        else:
            groups = next(n for n in (16, 8, 4, 2, 1) if features % n == 0)
            norm = nn.GroupNorm(groups, features)
        setattr(module, name, norm)


def widened(weight: Tensor, channels: int) -> Tensor:
    """(O, C, k, k) weights of a first layer, divided among the images that (O, channels, k, k) ones read at once."""
    repeat = channels // weight.shape[1]
    return weight.repeat(1, repeat, 1, 1) / repeat
