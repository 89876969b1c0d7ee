"""Encoders: from observations and goals to tokens, one file a kind."""

from playlearn.policies.encoders.base import Encoder, EncoderConfig, Modality, Tokens
from playlearn.policies.encoders.cnn import CNNConfig
from playlearn.policies.encoders.hand import HandConfig, HandEncoder
from playlearn.policies.encoders.image import ImageConfig
from playlearn.policies.encoders.keypoints import KeypointsConfig
from playlearn.policies.encoders.state import StateConfig
from playlearn.policies.encoders.tokens import TokensConfig
from playlearn.policies.encoders.torchvision import TorchvisionConfig
from playlearn.policies.encoders.transformers import TransformersConfig

__all__ = [
    "CNNConfig",
    "Encoder",
    "EncoderConfig",
    "HandConfig",
    "HandEncoder",
    "ImageConfig",
    "KeypointsConfig",
    "Modality",
    "StateConfig",
    "Tokens",
    "TokensConfig",
    "TorchvisionConfig",
    "TransformersConfig",
]
