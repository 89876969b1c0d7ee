"""What is said where a loss, a gradient or a weight is no longer finite: whether the data are to blame."""

from collections.abc import Iterable

import torch

from playlearn.batch import Batch
from playlearn.policies import PolicySpec
from playlearn.training.config import TrainConfig


def reason(config: TrainConfig, spec: PolicySpec, batches: Iterable[Batch]) -> str:
    """Why training diverged, and what to do; batches: those whose loss is not finite, or whose gradient."""
    found = next((wrong for batch in batches if (wrong := not_finite(batch, spec)) is not None), None)
    if found is not None:
        return f"its data are to blame: {found[1]} in example {found[0]} of the batch"
    return (
        f"its data are finite, so its updates are too large: lower lr ({config.lr:g}) or grad_clip "
        f"({config.grad_clip:g}), or raise warmup ({config.warmup})"
    )


def not_finite(batch: Batch, spec: PolicySpec) -> tuple[int, str] | None:
    """The first number of a batch that is NaN or infinite: its example, and which it is; None where there is none."""
    names = {
        "state": spec.state_names,
        "achieved": spec.achieved_names,
        "goal_achieved": spec.achieved_names,
        "goal_proprio": spec.state_names,
        "action": spec.action_names,
    }
    for array, own in names.items():
        values: torch.Tensor = getattr(batch, array)
        wrong = torch.nonzero(~torch.isfinite(values)).tolist()
        if wrong:
            at = tuple(wrong[0])
            return at[0], f"{array} {own[at[-1]]} is {float(values[at]):g}"
    return None
