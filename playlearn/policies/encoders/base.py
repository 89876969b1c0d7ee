"""What every encoder offers: observation history and goal in, tokens out."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import draccus
import torch
from torch import Tensor, nn

from playlearn.batch import Inputs
from playlearn.policies.spec import Named, PolicySpec, goal_dimensions

Modality = Literal["state", "image"]


@dataclass(frozen=True)
class EncoderConfig(draccus.ChoiceRegistry):
    """The base of every encoder's config; `type:` in a YAML picks the kind.

    goal_names: shell-style patterns of the achieved dimensions that a goal covers.
    """

    goal_names: tuple[str, ...] = ("*",)

    @property
    def goals(self) -> tuple[Modality, ...]:
        """How a goal may be given; the first is the default."""
        raise NotImplementedError

    @property
    def observation_cameras(self) -> tuple[str, ...]:
        """The cameras whose images an observation must hold."""
        return ()

    @property
    def goal_cameras(self) -> tuple[str, ...]:
        """The cameras whose images a goal image must hold."""
        return ()

    @property
    def uses_goal_proprio(self) -> bool:
        """Whether a goal must hold the robot's own state."""
        return False

    @property
    def uses_events(self) -> bool:
        """Whether training reads the robot's own state at events ahead (see `relabeling.hand`)."""
        return False

    @property
    def needs_achieved(self) -> bool:
        """Whether `achieved` must have dimensions that a goal covers."""
        return "state" in self.goals

    @property
    def supervised(self) -> bool:
        """Whether training also reads `achieved` of observation and goal, which acting does not."""
        return False

    def check_goal(self, spec: Named, where: str = "this play") -> None:
        """Raises UsageError where there is no goal to reach in such play. where: its store, for the message."""
        if self.needs_achieved:
            goal_dimensions(spec.achieved_names, self.goal_names, where)

    def complete(self) -> "EncoderConfig":
        """The same with everything that building needs, so that a saved policy is built without network access."""
        return self

    def build(self, spec: PolicySpec, width: int, *, fetch: bool = True) -> "Encoder":
        """The encoder.

        width: D of a token.
        fetch: whether weights may be downloaded, if the config asks for any.
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Tokens:
    """What an encoder returns.

    goal: (B, N, D).
    steps: (B, T, M, D).
    observed: (B, T, G) estimates of the normalized `achieved`, of encoders that make them.
    wanted: (B, G) estimates of the normalized `achieved` of the goal.
    heatmaps: camera -> (B, T, K, h, w) logits, of encoders that make them.
    goal_heatmaps: camera -> (B, K, h, w) logits, of the goal image.
    proposals: of where the hand goes next, of encoders that make them.
    """

    goal: Tensor
    steps: Tensor
    observed: Tensor | None = None
    wanted: Tensor | None = None
    heatmaps: Mapping[str, Tensor] = field(default_factory=dict)
    goal_heatmaps: Mapping[str, Tensor] = field(default_factory=dict)
    proposals: "Proposals | None" = None


@dataclass(frozen=True, eq=False)
class Proposals:
    """What the N cells of an image propose for E events of the robot's own future (see `hand.py`).

    logits: (B, E, N) confidence of each cell.
    states: (B, E, N, S) normalized robot states.
    ahead: (B, E) logits of whether the event lies ahead.
    shift: (B, 2), x and y in [-1, 1], by which the images were shifted.
    answers: (B, E, K) confidence of each answer that a closer look at the most confident cell gives.
    refined: (B, E, K, S) these answers, normalized robot states.
    """

    logits: Tensor
    states: Tensor
    ahead: Tensor
    shift: Tensor
    answers: Tensor
    refined: Tensor


class Encoder(nn.Module):
    """Turns normalized inputs into tokens. goal_tokens: N, step_tokens: M of `Tokens`."""

    goal_tokens: int
    step_tokens: int

    def forward(self, inputs: Inputs, keep: Tensor, generator: torch.Generator | None = None) -> Tokens:
        """The tokens.

        inputs: state and achieved normalized, images uint8.
        keep: (B,) bool, False where the goal is dropped.
        generator: draws the augmentation; None for none (evaluation).
        """
        raise NotImplementedError

    def token_parameters(self) -> Iterable[nn.Parameter]:
        """The parameters that receive gradients through the tokens; the others learn from `auxiliary` alone."""
        return self.parameters()

    def calibrate(self, project: Callable[[str, Sequence[int]], Tensor]) -> None:
        """Before the first update: fit what is read off the play and not learned.

        project: of a camera and of the numbers of the state that move the hand, see `data.projection`.
        """

    def perceive(self, inputs: Inputs, generator: torch.Generator | None = None) -> Tokens:
        """The part of `forward` that `auxiliary` needs; its tokens may be empty."""
        keep = torch.ones(len(inputs.state), dtype=torch.bool, device=inputs.state.device)
        tokens: Tokens = self(inputs, keep, generator)
        return tokens

    def auxiliary(self, tokens: Tokens, inputs: Inputs) -> dict[str, Tensor]:
        """Weighted auxiliary losses by name; used in training only."""
        return {}
