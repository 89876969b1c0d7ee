"""Any torchvision classifier's body as a camera's network, from scratch or pretrained."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.errors import UsageError
from playlearn.policies.encoders.base import EncoderConfig
from playlearn.policies.encoders.cameras import channels_last
from playlearn.policies.encoders.image import ImageConfig


@EncoderConfig.register_subclass("torchvision")
@dataclass(frozen=True)
class TorchvisionConfig(ImageConfig):
    """name: as in `torchvision.models.list_models()`. weights: null for none, else a name such as DEFAULT, downloaded.

    From scratch, batch norm becomes group norm; pretrained, its statistics are frozen. Either way an
    example's features do not depend on its neighbours in the batch.
    """

    name: str = "resnet18"
    weights: str | None = None

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        body = _body(self.name, self.weights if fetch else None)
        _replace_batch_norm(body, frozen=self.weights is not None)
        if channels != 3:
            _widen_first_convolution(body, channels)
        channels_last(body)
        with torch.no_grad():
            inputs = body.eval()(torch.zeros(1, channels, *size)).flatten(1).shape[1]
        return nn.Sequential(
            _ImageNetScale(channels), body.train(), nn.Flatten(), nn.Linear(inputs, self.features), nn.ReLU()
        )


class _ImageNetScale(nn.Module):
    """[-1, 1] to the mean and spread that torchvision's weights were trained with."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
        repeat = channels // 3
        self.register_buffer("mean", (2 * mean - 1).repeat(repeat)[:, None, None], persistent=False)
        self.register_buffer("std", (2 * std).repeat(repeat)[:, None, None], persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        return (images - self.get_buffer("mean")) / self.get_buffer("std")


def _body(name: str, weights: str | None) -> nn.Module:
    # torchvision takes seconds to import: only who builds this encoder pays
    from torchvision import models

    if name not in models.list_models(module=models):
        raise UsageError(f"encoder.name {name!r} is no torchvision classifier; see torchvision.models.list_models()")
    try:
        model: nn.Module = models.get_model(name, weights=weights)
    except OSError as error:
        raise UsageError(
            f"the {weights} weights of {name} cannot be downloaded ({error}); set encoder.weights to null to train "
            "from scratch, or try again where the network is"
        ) from error
    except KeyError as error:
        raise UsageError(f"encoder.weights {weights!r}: {name} has none of that name; DEFAULT always exists") from error
    for head in ("fc", "classifier", "heads", "head"):
        if hasattr(model, head):
            setattr(model, head, nn.Identity())
            return model
    raise UsageError(f"encoder.name {name!r}: its classifier cannot be taken off; try resnet18 or mobilenet_v3_small")


def _replace_batch_norm(module: nn.Module, *, frozen: bool) -> None:
    from torchvision.ops import FrozenBatchNorm2d

    for name, child in module.named_children():
        if not isinstance(child, nn.BatchNorm2d):
            _replace_batch_norm(child, frozen=frozen)
            continue
        features = child.num_features
        if frozen:
            norm: nn.Module = FrozenBatchNorm2d(features, eps=child.eps)
            norm.load_state_dict(child.state_dict(), strict=False)
        else:
            groups = next(n for n in (16, 8, 4, 2, 1) if features % n == 0)
            norm = nn.GroupNorm(groups, features)
        setattr(module, name, norm)


def _widen_first_convolution(body: nn.Module, channels: int) -> None:
    """Let the first layer read more images at once, its weights shared out among them."""
    for parent in body.modules():
        for name, child in parent.named_children():
            if isinstance(child, nn.Conv2d):
                wide = nn.Conv2d(
                    channels,
                    child.out_channels,
                    child.kernel_size,  # type: ignore[arg-type]
                    child.stride,  # type: ignore[arg-type]
                    child.padding,  # type: ignore[arg-type]
                    bias=child.bias is not None,
                )
                repeat = channels // child.in_channels
                wide.weight.data = child.weight.data.repeat(1, repeat, 1, 1) / repeat
                if child.bias is not None and wide.bias is not None:
                    wide.bias.data = child.bias.data
                setattr(parent, name, wide)
                return
