"""What data hands to policies: inputs, labeled batches, and the statistics that normalize them."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from playlearn.episode import Array
from playlearn.quantity import ROUNDING

EVENTS = ("grasp", "settled")  # of the robot's own future, see `relabeling.hand`


@dataclass(frozen=True, eq=False, kw_only=True)
class Inputs:
    """What a policy reads: observation history and goal of B examples, example b at step t of its episode.

    state: (B, T, S) float32, the robot's own state in the observations t-T+1 ... t.
    achieved: (B, T, G) float32, of the same observations.
    history_mask: (B, T) bool, False before an episode's first observation, which is then repeated.
    goal_achieved: (B, G) float32, of the goal.
    goal_proprio: (B, S) float32, the robot's own state at the goal.
    images: camera -> (B, T, h, w, 3) uint8.
    goal_images: camera -> (B, h, w, 3) uint8; empty where the goal is a state.
    keypoints: camera -> (B, T, O, 2) float32, where the camera sees each object of `ObjectLayout.places`, x and y in
        [-1, 1], NaN where unknown. Only in training, and only of scenes that a simulator drew; else empty.
    goal_keypoints: camera -> (B, O, 2) float32, of the goal image.
    events: name -> (B, S) float32, the robot's own state at an event on the way to the goal, `grasp` or `settled` (see
        `relabeling.hand`), NaN where it does not lie ahead. Only in training, read from the recording's future; else
        empty.
    """

    state: Tensor
    achieved: Tensor
    history_mask: Tensor
    goal_achieved: Tensor
    goal_proprio: Tensor
    images: Mapping[str, Tensor] = field(default_factory=dict)
    goal_images: Mapping[str, Tensor] = field(default_factory=dict)
    keypoints: Mapping[str, Tensor] = field(default_factory=dict)
    goal_keypoints: Mapping[str, Tensor] = field(default_factory=dict)
    events: Mapping[str, Tensor] = field(default_factory=dict)

    def __len__(self) -> int:
        """B."""
        return len(self.state)

    def to(self, device: torch.device | str) -> Self:
        """The same on another device."""

        def move(value: Tensor | Mapping[str, Tensor]) -> Any:
            if isinstance(value, Mapping):
                return {camera: tensor.to(device, non_blocking=True) for camera, tensor in value.items()}
            return value.to(device, non_blocking=True)

        return type(self)(**{entry.name: move(getattr(self, entry.name)) for entry in dataclasses.fields(self)})


@dataclass(frozen=True, eq=False, kw_only=True)
class Batch(Inputs):
    """The same with what a learner copies.

    action: (B, H, A) float32, the labels of the steps t ... t+H-1, the last one repeated past the end; or the change of
        `achieved` ahead, H = 1 and A = G (see `DataConfig.target`).
    action_mask: (B, H) bool, False where a label does not count: past the end, past a mistake, past the goal.
    steps_to_goal: (B,) int64, actions between t and the goal; 0 where none leads there (a goal of another episode, or
        of the past).
    """

    action: Tensor
    action_mask: Tensor
    steps_to_goal: Tensor


@dataclass(frozen=True, eq=False)
class Statistics:
    """Of one recorded vector, each (D,) float32; std is 0, or a rounding error, where a dimension does not vary."""

    mean: Array
    std: Array

    @property
    def varies(self) -> NDArray[np.bool_]:
        """(D,) whether a dimension varies by more than float32 rounds it, whatever its unit."""
        return np.asarray(np.asarray(self.std) > ROUNDING * np.abs(self.mean))
