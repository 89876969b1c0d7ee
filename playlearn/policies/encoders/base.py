"""What every encoder offers: observation history and goal in, tokens out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import draccus
import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.policies.inputs import PolicySpec

Modality = Literal["state", "image"]


@dataclass(frozen=True)
class EncoderConfig(draccus.ChoiceRegistry):
    """The base of every encoder's config; `type:` in a YAML picks the kind.

    goal_names: shell-style patterns of the achieved dimensions that a goal speaks of.
    """

    goal_names: tuple[str, ...] = ("*",)

    @property
    def goals(self) -> tuple[Modality, ...]:
        """What a goal may be shown as; the first where nothing else is said."""
        raise NotImplementedError

    @property
    def observation_cameras(self) -> tuple[str, ...]:
        """The cameras an observation must bring."""
        return ()

    @property
    def goal_cameras(self) -> tuple[str, ...]:
        """The cameras a goal that is an image must bring."""
        return ()

    @property
    def uses_goal_proprio(self) -> bool:
        """Whether a goal must bring the robot's own state."""
        return False

    def complete(self) -> "EncoderConfig":
        """The same with all that building takes, so that what is saved can be built without asking the network."""
        return self

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "Encoder":
        """width: D of a token. fetch: whether weights may be downloaded, if the config asks for any."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Tokens:
    """goal (B, N, D), steps (B, T, M, D); estimates of the normalized achieved, (B, T, G) and (B, G), where made.

    heatmaps, goal_heatmaps: camera -> (B, T, K, h, w) and (B, K, h, w) logits, of encoders that make them.
    """

    goal: Tensor
    steps: Tensor
    observed: Tensor | None = None
    wanted: Tensor | None = None
    heatmaps: Mapping[str, Tensor] = field(default_factory=dict)
    goal_heatmaps: Mapping[str, Tensor] = field(default_factory=dict)


class Encoder(nn.Module):
    """Turns normalized inputs into tokens. goal_tokens: N, step_tokens: M of `Tokens`."""

    goal_tokens: int
    step_tokens: int

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        """inputs: state and achieved normalized, images uint8. keep: (B,) bool, False where the goal is withheld.

        generator: draws the augmentation; None for none (evaluation).
        """
        raise NotImplementedError

    def token_parameters(self) -> Iterable[nn.Parameter]:
        """The parameters that a loss of the tokens teaches; the others learn from `auxiliary` alone."""
        return self.parameters()

    def perceive(self, inputs: Inputs, generator: torch.Generator | None = None) -> Tokens:
        """What `auxiliary` needs of `forward`, and no more; its tokens may be empty."""
        keep = torch.ones(len(inputs.state), dtype=torch.bool, device=inputs.state.device)
        tokens: Tokens = self(inputs, keep, generator)
        return tokens

    def auxiliary(self, tokens: Tokens, inputs: Inputs) -> dict[str, Tensor]:
        """Weighted losses of what is learned on the side, by name; used in training only."""
        return {}
