"""Whether a stage of the demo worked; if not, why, in a sentence."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def val_losses(run: Path, part: str) -> list[tuple[int, float]]:
    """(update, that part of the held-out loss) of a run, from its metrics.jsonl."""
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    return [(int(row["step"]), float(row[f"val/{part}"])) for row in rows if f"val/{part}" in row]


def training_problem(what: str, run: Path, part: str, level: float, planned: int) -> str | None:
    """Why the run learned too little for the next stage, None where it learned enough.

    part: of the loss, `head` of a policy, `achieved` of an image encoder.
    level: see `DemoConfig.state_loss`.
    planned: updates that the demo's config asks for.
    """
    losses = val_losses(run, part)
    if not losses:
        return f"{what}: nothing was held out, so what it learned is unknown"
    updates, last = losses[-1]
    if last <= level:
        return None
    reason = (
        f"it made {updates} updates, the demo's config asks for {planned}"
        if updates < planned
        else "there is too little play, or of another kind, or the learning rate does not suit it"
    )
    return f"{what}: its held-out loss is {last:.3g}; above {level:.3g} no goal is reached. Likely cause: {reason}"


def success_problem(results: Mapping[str, Any]) -> str | None:
    """Why an evaluation shows nothing, None where the policy does better than a random policy."""
    low, random = results["ci95"][0], results["references"]["random"]
    if low > random["ci95"][1]:
        return None
    return (
        f"the policy reached {results['success_rate']:.1%} of {results['episodes']} goal images, a random policy "
        f"{random['success_rate']:.1%}: it is no better than random. Likely cause: it was trained too little"
    )
