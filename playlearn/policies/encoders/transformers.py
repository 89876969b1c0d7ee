"""Any vision model of `transformers` as a camera's backbone: from scratch or pretrained, frozen or fine-tuned."""

from dataclasses import dataclass, field, replace
from inspect import signature
from typing import Any

import torch
from torch import Tensor, nn

from playlearn.errors import UsageError
from playlearn.policies.encoders.backbones import IMAGENET, Frozen, Scale, replace_batch_norm, widened
from playlearn.policies.encoders.base import EncoderConfig
from playlearn.policies.encoders.cameras import channels_last
from playlearn.policies.encoders.cnn import SpatialSoftmax
from playlearn.policies.encoders.image import ImageConfig

# fields of a model's config that do not decide its architecture
_NOTES = ("model_type", "architectures", "transformers_version", "dtype", "_name_or_path", "id2label", "label2id")


@EncoderConfig.register_subclass("transformers")
@dataclass(frozen=True)
class TransformersConfig(ImageConfig):
    """A vision model of `transformers`; a saved policy holds its whole config and loads without network access.

    name: a model type, such as resnet, convnextv2, vit or dinov2.
    options: fields of the model's config that differ from its defaults.
    weights: null for none, else a repository of the Hugging Face hub or a folder, which then also decides name and
        options; only safetensors are read.
    frozen: whether the backbone stays as the weights are.
    mean: of the colors that it expects, 0 to 1 (null: as given with the weights, else ImageNet's).
    std: of the colors that it expects (null: as for mean).
    """

    name: str = "resnet"
    options: dict[str, Any] = field(default_factory=dict)
    weights: str | None = None
    frozen: bool = False
    mean: tuple[float, ...] | None = None
    std: tuple[float, ...] | None = None

    def complete(self) -> "TransformersConfig":
        if self.frozen and self.weights is None:
            raise UsageError("encoder.frozen needs encoder.weights: frozen random weights learn nothing")
        plain = replace(self, mean=self.mean or IMAGENET[0], std=self.std or IMAGENET[1])
        if self.weights is None:
            known = _config(self.name, {})
            for option in self.options:
                if not hasattr(known, option):
                    raise UsageError(f"encoder.options: the config of {self.name} has no field {option!r}")
            return plain
        # transformers takes seconds to import, so only building this encoder does it
        from transformers import AutoConfig
        from transformers.image_processing_base import ImageProcessingMixin

        try:
            found = AutoConfig.from_pretrained(self.weights)
        except (OSError, ValueError) as error:
            raise self._unreachable(error) from error
        options = {name: value for name, value in found.to_diff_dict().items() if name not in _NOTES}
        try:
            colors: dict[str, Any] = ImageProcessingMixin.get_image_processor_dict(self.weights)[0]
        except (OSError, ValueError):
            colors = {}  # weights without a config of the images they were trained on
        return replace(
            plain,
            name=found.model_type,
            options={**options, **self.options},
            mean=self.mean or tuple(colors.get("image_mean", IMAGENET[0])),
            std=self.std or tuple(colors.get("image_std", IMAGENET[1])),
        )

    def backbone(self, channels: int, size: tuple[int, int], *, fetch: bool) -> nn.Module:
        config = _config(self.name, self.options)
        if channels != 3 and not hasattr(config, "num_channels"):
            raise UsageError(
                f"encoder.name {self.name!r} reads one image at a time, its config has no num_channels: "
                "set encoder.fusion to late"
            )
        given = None
        if self.weights is not None and fetch:
            given = self._given(config)
        if hasattr(config, "num_channels"):
            config.num_channels = channels
        if self.weights is None and hasattr(config, "image_size") and "image_size" not in self.options:
            config.image_size = size
        model = _model(config)
        if given is not None:
            held = {name: given[name] for name in model.state_dict()}
            wanted = {name: value.shape for name, value in model.state_dict().items()}
            model.load_state_dict(
                {name: one if one.shape == wanted[name] else widened(one, channels) for name, one in held.items()}
            )
        replace_batch_norm(model, pretrained=self.weights is not None)
        body = channels_last(_VisionModel(model, self.name, channels, size))
        backbone: nn.Module = Frozen(body) if self.frozen else body
        scale = Scale(channels, self.mean or IMAGENET[0], self.std or IMAGENET[1])
        return nn.Sequential(scale, backbone, nn.Linear(body.width, self.features), nn.ReLU())

    def _given(self, config: Any) -> dict[str, Tensor]:
        """The weights, of three channels, by name."""
        from transformers import AutoModel

        try:
            model = AutoModel.from_pretrained(self.weights, config=config, use_safetensors=True, dtype=torch.float32)
        except (OSError, ValueError, RuntimeError) as error:
            raise self._unreachable(error) from error
        state: dict[str, Tensor] = model.state_dict()
        return state

    def _unreachable(self, error: Exception) -> UsageError:
        return UsageError(
            f"encoder.weights {self.weights!r} cannot be loaded ({error}); set encoder.weights to null, name the model "
            "in encoder.name and train from scratch, or try again where the network is"
        )


class _VisionModel(nn.Module):
    """(B, C, h, w) -> (B, width): a spatial softmax of maps, the mean of tokens."""

    def __init__(self, model: nn.Module, name: str, channels: int, size: tuple[int, int]) -> None:
        super().__init__()
        self.model = model
        resizes = "interpolate_pos_encoding" in signature(model.forward).parameters
        self.arguments = {"interpolate_pos_encoding": True} if resizes else {}
        self.pool: nn.Module | None = None
        try:
            shape = self._features(torch.zeros(1, channels, *size)).shape
        except Exception as error:  # a model of text and images, or one that this image is too small for
            raise UsageError(
                f"encoder.name {name!r} does not read a {size[0]}x{size[1]} image ({type(error).__name__}: {error}); "
                "resnet, convnextv2, vit, dinov2 and clip_vision_model do, where their patches fit it"
            ) from error
        if len(shape) == 4:
            self.pool = SpatialSoftmax(*shape[1:])
        self.width = 4 * shape[1] if len(shape) == 4 else shape[-1]
        # a parameter that the features do not depend on, such as a mask token, is not trained
        parameters = list(model.parameters())
        features = self.forward(torch.rand(2, channels, *size)).sum()
        gradients = torch.autograd.grad(features, parameters, allow_unused=True)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.requires_grad_(gradient is not None)

    def forward(self, images: Tensor) -> Tensor:
        features = self._features(images)
        out: Tensor = features.mean(1) if self.pool is None else self.pool(features)
        return out

    def _features(self, images: Tensor) -> Tensor:
        out: Tensor = self.model(images, **self.arguments).last_hidden_state
        return out


def _config(name: str, options: dict[str, Any]) -> Any:
    from transformers import AutoConfig

    try:
        return AutoConfig.for_model(name, **options)
    except Exception as error:  # each config checks its fields in its own way
        raise UsageError(f"encoder.name {name!r} with encoder.options {options}: {error}") from error


def _model(config: Any) -> nn.Module:
    from transformers import AutoModel

    try:
        model: nn.Module = AutoModel.from_config(config)
    except ValueError as error:
        raise UsageError(f"encoder.name {config.model_type!r} is no vision model: {error}") from error
    pooler = getattr(model, "pooler", None)
    if pooler is not None and any(True for _ in pooler.parameters()):
        model.register_module("pooler", None)  # pools for a classifier that is not used
    return model
