"""Any torchvision classifier as a camera's backbone, from scratch or pretrained."""

from dataclasses import dataclass

import torch
from torch import nn

from playlearn.errors import UsageError
from playlearn.policies.encoders.backbones import IMAGENET, Frozen, Scale, replace_batch_norm, widened
from playlearn.policies.encoders.base import EncoderConfig
from playlearn.policies.encoders.cameras import channels_last
from playlearn.policies.encoders.image import ImageConfig


@EncoderConfig.register_subclass("torchvision")
@dataclass(frozen=True)
class TorchvisionConfig(ImageConfig):
    """A torchvision classifier without its last layer.

    name: as in `torchvision.models.list_models()`.
    weights: null for none, else a name such as DEFAULT, downloaded.
    frozen: whether the backbone stays as it was downloaded.

    From scratch, batch norm becomes group norm; pretrained, its statistics are frozen. Either way an example's features
    do not depend on the other examples of the batch.
    """

    name: str = "resnet18"
    weights: str | None = None
    frozen: bool = False

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        if self.frozen and self.weights is None:
            raise UsageError("encoder.frozen needs encoder.weights: frozen random weights learn nothing")
        body = _body(self.name, self.weights if fetch else None)
        replace_batch_norm(body, pretrained=self.weights is not None)
        if channels != 3:
            _widen_first_convolution(body, channels)
        channels_last(body)
        with torch.no_grad():
            inputs = body.eval()(torch.zeros(1, channels, *size)).flatten(1).shape[1]
        backbone = Frozen(body) if self.frozen else body.train()
        scale = Scale(channels, *IMAGENET)
        return nn.Sequential(scale, backbone, nn.Flatten(), nn.Linear(inputs, self.features), nn.ReLU())


def _body(name: str, weights: str | None) -> nn.Module:
    # torchvision takes seconds to import, so only building this encoder does it
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
    raise UsageError(f"encoder.name {name!r}: its last layer cannot be removed; try resnet18 or mobilenet_v3_small")


def _widen_first_convolution(body: nn.Module, channels: int) -> None:
    """Let the first layer read more images at once, its weights divided among them."""
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
                wide.weight.data = widened(child.weight.data, channels)
                if child.bias is not None and wide.bias is not None:
                    wide.bias.data = child.bias.data
                setattr(parent, name, wide)
                return
