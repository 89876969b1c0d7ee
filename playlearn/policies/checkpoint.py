"""The whole state of a training run in one safetensors file: weights, their average, the optimizer's moments."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn

from playlearn.config import atomic_write, make_folder
from playlearn.errors import CheckpointError

NOTE = "playlearn"


def first_not_finite(module: nn.Module) -> str | None:
    """The name of the first weight or buffer that is NaN or infinite; None where there is none."""
    named = module.state_dict().items()
    return next((name for name, value in named if not bool(torch.isfinite(value).all())), None)


def save_checkpoint(
    path: Path, modules: Mapping[str, nn.Module], optimizer: torch.optim.Optimizer, note: Mapping[str, Any]
) -> None:
    """Write atomically. modules: prefix -> module; note: JSON, stored in the file's metadata."""
    tensors: dict[str, Tensor] = {}
    for prefix, module in modules.items():
        tensors |= {f"{prefix}.{name}": value for name, value in module.state_dict().items()}
    for number, state in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": value for name, value in state.items()}
    make_folder(path.parent)
    flat = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    atomic_write(path, save(flat, metadata={NOTE: json.dumps(note)}))


def load_checkpoint(path: Path, modules: Mapping[str, nn.Module], optimizer: torch.optim.Optimizer) -> dict[str, Any]:
    """Restore what `save_checkpoint` was given; returns its note.

    Raises:
        CheckpointError: the file is missing, torn, of another network, or its weights are not finite.
    """
    if not path.is_file():
        raise CheckpointError(f"there is no checkpoint {path}")
    try:
        with safe_open(path, framework="pt") as file:
            note: dict[str, Any] = json.loads(file.metadata()[NOTE])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        for prefix, module in modules.items():
            module.load_state_dict(_under(prefix, tensors))
        parameters = [one for group in optimizer.param_groups for one in group["params"]]
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in _under("optimizer", tensors).items():
            number, _, field = name.partition(".")
            like = parameters[int(number)]
            if value.shape == like.shape:
                # a fused optimizer walks through memory: moments must have their parameter's layout
                value = torch.empty_like(like).copy_(value)
            state.setdefault(int(number), {})[field] = value
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except Exception as error:  # a torn file raises any of a dozen types
        raise CheckpointError(f"the checkpoint {path} cannot be read: {error}") from error
    for prefix, module in modules.items():
        wrong = first_not_finite(module)
        if wrong is not None:
            raise CheckpointError(
                f"the checkpoint {path} is of a run that diverged ({prefix}.{wrong} is not finite): nothing can go on "
                "from it; train again into another folder"
            )
    return note


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    start = f"{prefix}."
    return {name.removeprefix(start): value for name, value in tensors.items() if name.startswith(start)}
