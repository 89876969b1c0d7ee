"""Table and plot of a comparison."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from playlearn.privileges import KEY, Privileges
from playlearn.report.figure import save_figure

Row = Mapping[str, Any]
PERIOD = 50  # ms, of control at 20 Hz
COLUMNS = (
    "variant",
    "success rate",
    "95 %",
    "seeds",
    "privileged information",
    "parameters",
    "core seconds of training",
    "one chunk, ms (p50, p95)",
)
BLUE, GRAY, AMBER = "#2a6f97", "#9aa5b1", "#edae49"


def table(rows: Sequence[Row]) -> str:
    """Markdown, the best first; success rate with 95 % interval, over all seeds."""
    lines = [
        f"| {' | '.join(COLUMNS)} |",
        f"|{' --- |' * len(COLUMNS)}",
    ]
    for row in sorted(rows, key=lambda row: -row["success_rate"]):
        low, high = row["ci95"]
        seeds = ", ".join(f"{100 * rate:.0f}" for rate in row["by_seed"])
        latency = row["latency_ms"]
        lines.append(
            f"| {row['variant']} | **{100 * row['success_rate']:.0f} %** of {row['episodes']} "
            f"| {100 * low:.0f} to {100 * high:.0f} | {seeds} | {Privileges.from_dict(row[KEY])} "
            f"| {row['parameters'] / 1e6:.2f} M "
            f"| {_known(row['train_core_seconds'])} | {latency['p50']:.1f}, {latency['p95']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def _known(seconds: float | None) -> str:
    """Unknown for an interrupted training."""
    return "not known" if seconds is None else f"{seconds:.0f}"


def plot(rows: Sequence[Row], path: Path) -> None:
    """Success rate with intervals, a dot a seed; beside it the cost of training and of inference. Writes a PNG."""
    from matplotlib.figure import Figure

    ordered = sorted(rows, key=lambda row: row["success_rate"])
    places = range(len(ordered))
    figure = Figure(figsize=(9.5, 1.2 + 0.34 * len(ordered)), layout="constrained")
    success, training, latency = figure.subplots(1, 3, sharey=True, width_ratios=(2.2, 1, 1))
    rates = [100 * row["success_rate"] for row in ordered]
    below = [rate - 100 * row["ci95"][0] for rate, row in zip(rates, ordered, strict=True)]
    above = [100 * row["ci95"][1] - rate for rate, row in zip(rates, ordered, strict=True)]
    success.barh(places, rates, color=BLUE, height=0.62)
    success.errorbar(rates, places, xerr=(below, above), fmt="none", ecolor="black", elinewidth=1, capsize=2)
    for place, row in enumerate(ordered):
        success.plot([100 * rate for rate in row["by_seed"]], [place] * len(row["by_seed"]), ".", color=AMBER, ms=5)
    success.set(xlim=(0, 100), xlabel="success rate, % (95 % interval; a dot a seed)")
    success.set_yticks(list(places), [row["variant"] for row in ordered])
    training.barh(places, [(row["train_core_seconds"] or 0) / 60 for row in ordered], color=GRAY, height=0.62)
    training.set(xlabel="training, core minutes")
    latency.barh(places, [row["latency_ms"]["p50"] for row in ordered], color=GRAY, height=0.62)
    latency.plot([row["latency_ms"]["p95"] for row in ordered], places, "|", color="black")
    latency.set(xlabel="ms a chunk (| p95)", xscale="log", xlim=(1, 200))
    latency.set_xticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
    latency.minorticks_off()
    latency.axvline(PERIOD, color=AMBER, lw=1)
    for axes in (success, training, latency):
        axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path, dpi=130)
