"""Object tokens: one for each object of `achieved`, one for the robot.

A play store of an hour holds some hundred moves of each block. A network that reads all dimensions as one vector
overfits to those. One with shared weights for all objects, which reads positions relative to the gripper and to the
goal, learns from all of them as moves of one object; attention selects which one.

Objects come from the names (see ObjectLayout). Objects with the same parts are of one kind and share weights. Where the
robot's state has a part of the same name (`eef.x`), the token also holds the object's position relative to the robot.
"""

import torch
from torch import Tensor, nn

from playlearn.layout import ObjectLayout
from playlearn.policies.spec import PolicySpec

NEAR = 4.0  # for fine differences: a quarter of the data's std saturates tanh


class ObjectTokens(nn.Module):
    """See the module's docstring.

    goal_names: patterns of the dimensions that a goal covers.
    arm: whether a goal also holds the robot's state.
    count: M, the objects and, last, the robot.
    """

    def __init__(
        self, spec: PolicySpec, goal_names: tuple[str, ...], hidden: int, width: int, *, arm: bool = False
    ) -> None:
        super().__init__()
        layout = ObjectLayout(spec.achieved_names)
        chosen = set(layout.select(goal_names))
        objects = layout.objects().values()
        kinds: dict[tuple[str, ...], list[list[int]]] = {}
        for members in objects:
            kinds.setdefault(tuple(layout.parts[i] for i in members), []).append(members)
        robot = {part: i for i, part in enumerate(ObjectLayout(spec.state_names).parts)}
        self.kinds = nn.ModuleList(
            _Kind(parts, members, chosen, robot, hidden, width) for parts, members in kinds.items()
        )
        self.arm, width_in = arm, len(spec.state_names)
        self.robot = mlp(3 * width_in + 1 if arm else width_in, hidden, width)
        self.count = len(objects) + 1

    def forward(
        self, state: Tensor, achieved: Tensor, goal: Tensor, keep: Tensor, goal_proprio: Tensor | None = None
    ) -> Tensor:
        """(B, T, S), (B, T, G), (B, G), (B,) bool, False where the goal is dropped, and (B, S) to (B, T, M, D)."""
        tokens = [kind(state, achieved, goal, keep) for kind in self.kinds]
        proprio = state
        if self.arm and goal_proprio is not None:
            kept = keep[:, None, None].to(state.dtype)
            left = (goal_proprio.unsqueeze(1) - state) * kept  # (B, T, S)
            proprio = torch.cat([state, left, torch.tanh(NEAR * left), kept.expand(*state.shape[:2], 1)], dim=-1)
        return torch.cat([*tokens, self.robot(proprio).unsqueeze(2)], dim=2)


class _Kind(nn.Module):
    """The n objects that have the same P parts."""

    def __init__(
        self,
        parts: tuple[str, ...],
        members: list[list[int]],
        chosen: set[int],
        robot: dict[str, int],
        hidden: int,
        width: int,
    ) -> None:
        super().__init__()
        placed = [(k, robot[part]) for k, part in enumerate(parts) if part in robot and part in ("x", "y", "z")]
        self.register_buffer("members", torch.tensor(members), persistent=False)  # (n, P)
        in_goal = [[float(i in chosen) for i in own] for own in members]
        self.register_buffer("in_goal", torch.tensor(in_goal), persistent=False)  # (n, P)
        self.register_buffer("part", torch.tensor([k for k, _ in placed], dtype=torch.long), persistent=False)
        self.register_buffer("place", torch.tensor([i for _, i in placed], dtype=torch.long), persistent=False)
        self.net = mlp(3 * len(parts) + 2 * len(placed) + 1, hidden, width)
        self.name = nn.Parameter(torch.randn(len(members), width) * 0.1)

    def forward(self, state: Tensor, achieved: Tensor, goal: Tensor, keep: Tensor) -> Tensor:
        members = self.get_buffer("members")
        now = achieved[..., members]  # (B, T, n, P)
        kept = self.get_buffer("in_goal") * keep[:, None, None, None]
        left = (goal[:, None, members] - now) * kept
        place = state[..., self.get_buffer("place")].unsqueeze(2)  # (B, T, 1, R)
        away = now[..., self.get_buffer("part")] - place  # (B, T, n, R)
        given = keep[:, None, None, None].to(now.dtype).expand(*now.shape[:-1], 1)
        fine = [torch.tanh(NEAR * left), torch.tanh(NEAR * away)]
        tokens: Tensor = self.net(torch.cat([now, left, away, *fine, given], dim=-1))
        return tokens + self.name  # (B, T, n, D)


def mlp(inputs: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, out))
