"""A small convolutional network, made to train on a CPU within minutes."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from playlearn.policies.encoders.base import EncoderConfig
from playlearn.policies.encoders.image import ImageConfig, channels_last


@EncoderConfig.register_subclass("cnn")
@dataclass(frozen=True)
class CNNConfig(ImageConfig):
    """channels, kernels, strides: one of each a layer. pool: how the last map becomes a vector.

    The default reads large patches and keeps a fine map: for the same seconds on a CPU it places objects
    far better than more and narrower layers do.
    """

    channels: tuple[int, ...] = (32, 64)
    kernels: tuple[int, ...] = (8, 3)
    strides: tuple[int, ...] = (4, 2)
    pool: Literal["flatten", "spatial_softmax"] = "flatten"

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        convolutions = channels_last(nn.Sequential(*_layers(self, channels)))
        with torch.no_grad():
            _, depth, height, width = convolutions(torch.zeros(1, channels, *size)).shape
        if self.pool == "spatial_softmax":
            pool: nn.Module = SpatialSoftmax(height, width)
            inputs = 3 * depth
        else:
            pool, inputs = nn.Flatten(), depth * height * width
        return nn.Sequential(convolutions, pool, nn.Linear(inputs, self.features), nn.ReLU())


class SpatialSoftmax(nn.Module):
    """(B, C, h, w) -> (B, 3 C): each channel's expected x and y in [-1, 1] (Finn et al. 2016) and its mean.

    The mean tells whether what a channel looks for is there at all, a lit lamp say.
    """

    def __init__(self, height: int, width: int) -> None:
        super().__init__()
        y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
        self.register_buffer("places", torch.stack([x.flatten(), y.flatten()], dim=1), persistent=False)  # (h w, 2)

    def forward(self, maps: Tensor) -> Tensor:
        flat = maps.flatten(2)  # (B, C, h w)
        expected = flat.softmax(dim=-1) @ self.get_buffer("places")  # (B, C, 2)
        return torch.cat([expected.flatten(1), flat.mean(dim=-1)], dim=1)


def _layers(config: CNNConfig, channels: int) -> Iterable[nn.Module]:
    for out, kernel, stride in zip(config.channels, config.kernels, config.strides, strict=True):
        yield nn.Conv2d(channels, out, kernel, stride, (kernel - stride + 1) // 2)
        yield nn.ReLU()
        channels = out
