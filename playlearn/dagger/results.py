"""The results of a DAgger run: rows, and a plot of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from playlearn.dagger.rollouts import RolloutRecord
from playlearn.privileges import KEY as PRIVILEGED
from playlearn.report.compared import AMBER, BLUE, GRAY
from playlearn.report.figure import save_figure

Row = Mapping[str, Any]
_EVALUATION = ("success_rate", "ci95", "strict_rate", "strict_ci95", "episodes", "crashed", PRIVILEGED)


def evaluated(results: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a row that an evaluation gives."""
    return {name: results[name] for name in _EVALUATION}


def gathered(records: Sequence[RolloutRecord]) -> dict[str, Any]:
    """The part of a row that a round's rollouts give.

    attempted, kept: episodes.
    solved_without_expert: episodes in which the policy reached the goal by itself.
    frames: steps kept to learn from.
    labels: states that the expert labeled, those of discarded episodes too.
    expert_steps: steps in which the expert acted.
    discarded: how an episode ended -> how many of those that were not kept.
    """
    kept = [row for row in records if row.kept]
    return {
        "attempted": len(records),
        "kept": len(kept),
        "solved_without_expert": sum(row.solved_without_expert for row in records),
        "frames": sum(row.labels for row in kept),
        "labels": sum(row.labels for row in records),
        "expert_steps": sum(row.expert_steps for row in records),
        "discarded": _count(row.ended for row in records if not row.kept),
    }


def line(row: Row) -> str:
    """A row, to be read while the next round runs."""
    low, high = row["ci95"]
    success = f"round {row['round']}: success {row['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {row['episodes']}"
    if not row["round"]:
        return success + " by the policy it starts from"
    return success + f"; {row['frames']} steps added, {row['labels']} labels, {row['expert_steps']} steps by the expert"


def plot(rows: Sequence[Row], path: Path) -> None:
    """Success round by round with its 95 % interval, and what it cost so far. Writes a PNG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    rounds = [row["round"] for row in rows]
    rates = [100 * row["success_rate"] for row in rows]
    below = [rate - 100 * row["ci95"][0] for rate, row in zip(rates, rows, strict=True)]
    above = [100 * row["ci95"][1] - rate for rate, row in zip(rates, rows, strict=True)]
    figure = Figure(figsize=(8.5, 3.4), layout="constrained")
    success, spent = figure.subplots(1, 2)
    success.errorbar(rounds, rates, yerr=(below, above), color=BLUE, marker="o", capsize=3)
    success.set(ylim=(0, 100), xlabel="round (0: the policy it starts from)", ylabel="success rate, % (95 % interval)")
    named = (
        ("labels", "states labeled by the expert", GRAY),
        ("frames", "steps added", BLUE),
        ("expert_steps", "steps by the expert", AMBER),
    )
    for name, label, color in named:
        totals = [sum(row.get(name, 0) for row in rows[: k + 1]) for k in range(len(rows))]
        spent.plot(rounds, totals, color=color, marker="o", label=label)
    spent.set(ylim=(0, None), xlabel="round", ylabel="steps so far")
    spent.legend(frameon=False)
    for axes in (success, spent):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path, dpi=130)


def _count(reasons: Any) -> dict[str, int]:
    """How often each reason occurred, without its details."""
    counts: dict[str, int] = {}
    for reason in reasons:
        kind = reason.partition(":")[0]
        counts[kind] = counts.get(kind, 0) + 1
    return counts
