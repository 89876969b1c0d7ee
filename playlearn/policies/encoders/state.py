"""Tokens from the robot's state, from `achieved`, and from the difference to the goal."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.policies.encoders.base import Encoder, EncoderConfig, Modality, Tokens
from playlearn.policies.encoders.objects import ObjectTokens
from playlearn.policies.spec import PolicySpec


@EncoderConfig.register_subclass("state")
@dataclass(frozen=True)
class StateConfig(EncoderConfig):
    """One token an object, one for the robot.

    hidden: units of the two-layer networks that make a token.
    goal_proprio: whether a goal also holds the robot's own state. Where `achieved` is empty, or `goal_names` is, a
        goal is that state alone.
    """

    hidden: int = 256
    goal_proprio: bool = False

    @property
    def goals(self) -> tuple[Modality, ...]:
        return ("state",)

    @property
    def uses_goal_proprio(self) -> bool:
        return self.goal_proprio

    @property
    def needs_achieved(self) -> bool:
        return not self.goal_proprio

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "StateEncoder":
        return StateEncoder(self, spec, width)


class StateEncoder(Encoder):
    """One goal token, for whether there is a goal; for each step one token an object and one for the robot."""

    goal_tokens = 1

    def __init__(self, config: StateConfig, spec: PolicySpec, width: int) -> None:
        super().__init__()
        self.objects = ObjectTokens(spec, config.goal_names, config.hidden, width, arm=config.goal_proprio)
        self.step_tokens = self.objects.count
        self.goal_flag = nn.Parameter(torch.randn(2, width) * 0.02)  # without, with a goal

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        steps = self.objects(inputs.state, inputs.achieved, inputs.goal_achieved, keep, inputs.goal_proprio)
        return Tokens(goal=self.goal_flag[keep.long()].unsqueeze(1), steps=steps)
