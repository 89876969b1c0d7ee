"""A goal state as one vector, for image encoders."""

import torch
from torch import Tensor, nn

from playlearn.policies.encoders.objects import mlp
from playlearn.policies.spec import PolicySpec, goal_dimensions


class GoalStateEncoder(nn.Module):
    """(B, G) normalized achieved of a goal -> (B, D), of the dimensions that goals cover."""

    def __init__(self, spec: PolicySpec, goal_names: tuple[str, ...], hidden: int, width: int) -> None:
        super().__init__()
        self.register_buffer(
            "dimensions", torch.tensor(goal_dimensions(spec.achieved_names, goal_names)), persistent=False
        )
        self.net = mlp(len(self.get_buffer("dimensions")), hidden, width)

    def forward(self, goal: Tensor) -> Tensor:
        out: Tensor = self.net(goal[:, self.get_buffer("dimensions")])
        return out
