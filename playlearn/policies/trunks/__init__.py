"""Trunks: sequence models from the tokens of goal and history to features, one file a kind."""

from playlearn.policies.trunks.base import Trunk, TrunkConfig
from playlearn.policies.trunks.lstm import LSTMConfig
from playlearn.policies.trunks.mlp import MLPConfig
from playlearn.policies.trunks.transformer import TransformerConfig

__all__ = ["LSTMConfig", "MLPConfig", "TransformerConfig", "Trunk", "TrunkConfig"]
