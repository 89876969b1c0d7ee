"""Whether a stage of the demo came to something, in a sentence."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def val_losses(run: Path, part: str) -> list[tuple[int, float]]:
    """(update, that part of the held-out loss) of a run, as its metrics.jsonl tells."""
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    return [(int(row["step"]), float(row[f"val/{part}"])) for row in rows if f"val/{part}" in row]


def judge_training(what: str, run: Path, part: str, level: float, planned: int) -> str | None:
    """Why the run has taught too little to go on with, None where it has not.

    part: of the loss, `head` of a policy, `achieved` of an image encoder. level: see `DemoConfig.state_loss`.
    """
    losses = val_losses(run, part)
    if not losses:
        return f"{what}: nothing was held out, so that nobody can say what it learned"
    updates, last = losses[-1]
    if last <= level:
        return None
    reason = (
        f"it made {updates} updates, the demo's config says {planned}"
        if updates < planned
        else "the play is too little or of another kind, or the learning rate does not suit it"
    )
    return f"{what}: its held-out loss is {last:.3g}, and above {level:.3g} nothing is reached; likely because {reason}"


def judge_success(results: Mapping[str, Any]) -> str | None:
    """Why an evaluation shows nothing, None where its policy does better than random actions."""
    low, chance = results["ci95"][0], results["references"]["random"]
    if low > chance["ci95"][1]:
        return None
    return (
        f"the policy reached {results['success_rate']:.1%} of {results['episodes']} goal images and random actions "
        f"{chance['success_rate']:.1%}: that is no better than chance; likely because it was trained too little"
    )
