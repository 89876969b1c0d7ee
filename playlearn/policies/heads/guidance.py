"""Classifier-free guidance (Ho and Salimans, 2022), for a single prediction and for a decoder's steps."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Guidance:
    """What the goal adds to a prediction, times `weight`.

    features: (B, D) of the same examples without their goal.
    weight: 0 ignores the goal, 1 is the plain prediction, more than 1 exaggerates what the goal adds.
    """

    features: Tensor
    weight: float

    def combine(self, with_goal: Tensor, without_goal: Tensor) -> Tensor:
        return without_goal + self.weight * (with_goal - without_goal)


def guided(predict: Callable[[Tensor], Tensor], features: Tensor, guidance: Guidance | None) -> Tensor:
    """`predict(features)`; with guidance, combined with what it predicts without the goal."""
    with_goal = predict(features)
    return with_goal if guidance is None else guidance.combine(with_goal, predict(guidance.features))


class GuidedRows:
    """The same for a decoder with a cache: every example with its goal, then every example without it, in one batch.

    R, the number of rows, is 2 B with guidance and B without.

    features: (R, D).
    """

    def __init__(self, features: Tensor, guidance: Guidance | None) -> None:
        self._guidance = guidance
        self.features = features if guidance is None else torch.cat([features, guidance.features])

    def expand(self, values: Tensor) -> Tensor:
        """(B, W) -> (R, W): both rows of an example get the same."""
        return values if self._guidance is None else values.repeat(2, 1)

    def combine(self, predicted: Tensor) -> Tensor:
        """(R, ...) -> (B, ...)."""
        return predicted if self._guidance is None else self._guidance.combine(*predicted.chunk(2))
