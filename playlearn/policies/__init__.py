"""Policies: encoder, trunk and head; a policy never sees an environment."""

from playlearn.policies.encoders import EncoderConfig
from playlearn.policies.execution import PolicyActor
from playlearn.policies.heads import HeadConfig
from playlearn.policies.policy import Policy, PolicyConfig, policy_digests
from playlearn.policies.spec import PolicySpec
from playlearn.policies.trunks import TrunkConfig

__all__ = [
    "EncoderConfig",
    "HeadConfig",
    "Policy",
    "PolicyActor",
    "PolicyConfig",
    "PolicySpec",
    "TrunkConfig",
    "policy_digests",
]
