"""Tokens from numbers: the robot's state, what is achieved, and how far that is from the goal."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from playlearn.policies.encoders.base import Encoder, EncoderConfig, Modality, Tokens
from playlearn.policies.inputs import Observed, PolicySpec


@EncoderConfig.register_subclass("state")
@dataclass(frozen=True)
class StateConfig(EncoderConfig):
    """hidden: units of the two-layer networks that make a token.

    noise: standard deviation of the noise on normalised numbers in training; play has few distinct goals,
    and a network that knows them to the last digit learns each by heart.
    """

    goal: ClassVar[Modality] = "state"
    hidden: int = 256
    noise: float = 0.0

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "StateEncoder":
        return StateEncoder(self, spec, width)


class StateEncoder(Encoder):
    """One goal token, one token a step."""

    goal_tokens = 1
    step_tokens = 1

    def __init__(self, config: StateConfig, spec: PolicySpec, width: int) -> None:
        super().__init__()
        self.noise = config.noise
        self.numbers = NumberTokens(spec, config.goal_names, config.hidden, width)

    def forward(self, inputs: Observed, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        state, achieved, goal = inputs.state, inputs.achieved, inputs.goal_achieved
        if generator is not None and self.noise > 0:
            state, achieved, goal = (
                n + self.noise * draw(n.shape, generator, n.device) for n in (state, achieved, goal)
            )
        goal_token, steps = self.numbers(state, achieved, goal, keep)
        return Tokens(goal=goal_token.unsqueeze(1), steps=steps.unsqueeze(2))


class NumberTokens(nn.Module):
    """A goal token and a token a step from normalised state, achieved and goal.

    The difference between goal and achieved is handed over explicitly: a small network would
    spend much of its training on finding the subtraction.
    """

    def __init__(self, spec: PolicySpec, goal_names: tuple[str, ...], hidden: int, width: int) -> None:
        super().__init__()
        chosen = spec.select(goal_names)
        self.register_buffer("chosen", torch.tensor(chosen), persistent=False)
        known = len(spec.state_names) + len(spec.achieved_names)
        self.step = mlp(known + len(chosen), hidden, width)
        self.goal = mlp(len(chosen), hidden, width)
        self.null_goal = nn.Parameter(torch.randn(width) * 0.02)
        self.null_difference = nn.Parameter(torch.randn(len(chosen)) * 0.02)

    def forward(self, state: Tensor, achieved: Tensor, goal: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        """From (B, T, S), (B, T, G), (B, G) and (B,) to a goal token (B, D) and step tokens (B, T, D)."""
        chosen = self.get_buffer("chosen")
        wanted = goal[:, chosen]  # (B, chosen)
        difference = wanted.unsqueeze(1) - achieved[..., chosen]  # (B, T, chosen)
        difference = torch.where(keep[:, None, None], difference, self.null_difference)
        goal_token = torch.where(keep[:, None], self.goal(wanted), self.null_goal)
        return goal_token, self.step(torch.cat([state, achieved, difference], dim=-1))


def draw(shape: torch.Size, generator: torch.Generator, device: torch.device) -> Tensor:
    """Standard normal numbers, drawn where the generator lives."""
    return torch.randn(shape, generator=generator, device=generator.device).to(device)


def mlp(inputs: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, out))
