"""Error of a trained policy's actions on the held-out play of its run."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from playlearn.config import from_dict, read_config
from playlearn.data import DataConfig, PlayDataset
from playlearn.errors import StoreError
from playlearn.policies import Policy
from playlearn.store import open_store, parse_store

EXAMPLES = 2048  # of held-out play


@torch.no_grad()
def action_errors(run: Path) -> dict[str, Any]:
    """Mean error of the first action of a chunk, by the skill of that step of held-out play.

    An error is the mean over the action's numbers, each as a share of its spread in the data.

    The play is the validation split of the run's store. The skill with the largest error comes first.
    """
    empty: dict[str, Any] = {"skills": {}, "examples": 0, "note": ""}
    path = run / "config.yaml"
    raw = read_config(path) if path.is_file() else None
    missing = empty | {"note": "not measured: the run's play is not there"}
    if not raw:
        return missing
    try:
        store = open_store(parse_store(raw["store"]), blind=bool(raw.get("blind")))
    except StoreError:
        return missing
    data = from_dict(DataConfig, raw["data"])
    if data.val_fraction <= 0:
        return empty | {"note": "not measured: the run held no play out"}
    dataset: PlayDataset = data.build(store, "val", int(raw.get("seed", 0)))
    policy = Policy.load(run / "policy").eval()
    annotations = [store.meta(int(i)).annotations() for i in range(len(store))]
    errors: dict[str, list[float]] = {}
    drawn = np.random.default_rng(0).permutation(len(dataset))[:EXAMPLES]
    for part in np.array_split(drawn, max(1, len(drawn) // 256)):
        batch = dataset.batch(0, part)
        chunk = policy.act(batch, torch.Generator().manual_seed(0))
        error = policy.action_error(chunk, batch.action)[:, 0]  # (B,)
        for value, i, t in zip(error.tolist(), *dataset.where(part), strict=True):
            skill = store.array(int(i), "skill")[t]
            name = annotations[i][skill][0]
            errors.setdefault(name, []).append(value)
    ordered = sorted(errors, key=lambda name: float(np.mean(errors[name])), reverse=True)
    rows = {name: {"examples": len(errors[name]), "error": float(np.mean(errors[name]))} for name in ordered}
    return empty | {"skills": rows, "examples": len(drawn)}
