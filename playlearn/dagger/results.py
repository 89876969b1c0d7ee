"""What a DAgger run came to: rows, and a plot of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from playlearn.dagger.rollouts import RolloutRecord
from playlearn.report.compared import AMBER, BLUE, GRAY

Row = Mapping[str, Any]
_JUDGED = ("success_rate", "ci95", "strict_rate", "strict_ci95", "episodes", "crashed")


def evaluated(results: Mapping[str, Any]) -> dict[str, Any]:
    """What a row says of an evaluation."""
    return {name: results[name] for name in _JUDGED}


def gathered(tried: Sequence[RolloutRecord]) -> dict[str, Any]:
    """What a row says of a round's practice.

    frames: steps kept to learn from. labels: states that the expert was asked about, those thrown away too; driven:
    steps that it acted in itself. alone: episodes in which the policy got to the goal without it.
    """
    kept = [row for row in tried if row.kept]
    return {
        "attempted": len(tried),
        "kept": len(kept),
        "solved_without_expert": sum(row.solved_without_expert for row in tried),
        "frames": sum(row.labels for row in kept),
        "labels": sum(row.labels for row in tried),
        "expert_steps": sum(row.expert_steps for row in tried),
        "discarded": _count(row.ended for row in tried if not row.kept),
    }


def line(row: Row) -> str:
    """A row, to be read while the next round runs."""
    low, high = row["ci95"]
    reached = f"round {row['round']}: {row['success_rate']:.1%} [{low:.1%}, {high:.1%}] of {row['episodes']} reached"
    if not row["round"]:
        return reached + " by the policy it starts from"
    return reached + f"; {row['frames']} steps added, {row['labels']} labels asked, {row['expert_steps']} steps driven"


def plot(rows: Sequence[Row], path: Path) -> None:
    """Success round by round with its 95 % interval, and what it cost so far. Writes a PNG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    rounds = [row["round"] for row in rows]
    rates = [100 * row["success_rate"] for row in rows]
    below = [rate - 100 * row["ci95"][0] for rate, row in zip(rates, rows, strict=True)]
    above = [100 * row["ci95"][1] - rate for rate, row in zip(rates, rows, strict=True)]
    figure = Figure(figsize=(8.5, 3.4), layout="constrained")
    reached, spent = figure.subplots(1, 2)
    reached.errorbar(rounds, rates, yerr=(below, above), color=BLUE, marker="o", capsize=3)
    reached.set(ylim=(0, 100), xlabel="round (0: the policy it starts from)", ylabel="goals reached, % (95 % interval)")
    named = (
        ("labels", "labels asked of the expert", GRAY),
        ("frames", "steps added", BLUE),
        ("expert_steps", "steps it drove", AMBER),
    )
    for name, words, color in named:
        totals = [sum(row.get(name, 0) for row in rows[: k + 1]) for k in range(len(rows))]
        spent.plot(rounds, totals, color=color, marker="o", label=words)
    spent.set(ylim=(0, None), xlabel="round", ylabel="steps so far")
    spent.legend(frameon=False)
    for axes in (reached, spent):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def _count(reasons: Any) -> dict[str, int]:
    """How often each reason came, without its details."""
    counts: dict[str, int] = {}
    for reason in reasons:
        words = reason.partition(":")[0]
        counts[words] = counts.get(words, 0) + 1
    return counts
