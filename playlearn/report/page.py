"""An evaluation as one self-contained page: numbers, curves, pictures, films; nothing is fetched."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from playlearn.report.pictures import Pictures
from playlearn.report.template import template

WIDTH, HEIGHT = 960, 260  # of the plot, in its own units
LEFT, RIGHT, TOP, BOTTOM = 44, 12, 12, 36


@dataclass(frozen=True, eq=False)
class Shown:
    """One episode with its pictures."""

    episode: int
    task: str
    success: bool
    reason: str
    steps: int
    pictures: Pictures


def page(
    results: Mapping[str, Any], curves: Mapping[str, Sequence[float]], fps: float, shown: Sequence[Shown], note: str
) -> str:
    """The page as HTML.

    results: the content of results.json.
    curves: policy -> success rate by step 0, 1, ...; the evaluated policy first.
    fps: control steps a second.
    shown: episodes with pictures.
    note: why there are no pictures.
    """
    rows = {results["policy"]["name"]: results, **results["references"]}
    return template("page.html.j2").render(
        results=results,
        rows=rows,
        plot=_plot(curves, fps),
        successes=[item for item in shown if item.success],
        failures=[item for item in shown if not item.success],
        films=[item for item in shown if item.pictures.film is not None],
        note=note,
        fps=fps,
    )


@dataclass(frozen=True)
class _Plot:
    """A plot in SVG units.

    width, height, left, right, top, bottom: of the plot and its axes.
    lines: (policy, polyline points, y of its end).
    x_ticks, y_ticks: (position, label).
    """

    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int
    lines: list[tuple[str, str, float]]
    x_ticks: list[tuple[float, str]]
    y_ticks: list[tuple[float, str]]


def _plot(curves: Mapping[str, Sequence[float]], fps: float) -> _Plot:
    """Success rate against seconds."""
    steps = max(1, max(len(curve) for curve in curves.values()) - 1)
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def x(step: float) -> float:
        return LEFT + (right - LEFT) * step / steps

    def y(fraction: float) -> float:
        return bottom - (bottom - TOP) * fraction

    seconds = steps / fps
    gap = next((gap for gap in (0.5, 1, 2, 5, 10, 20, 60) if seconds / gap <= 8), 120)
    return _Plot(
        width=WIDTH,
        height=HEIGHT,
        left=LEFT,
        right=right,
        top=TOP,
        bottom=bottom,
        lines=[
            (name, " ".join(f"{x(t):.1f},{y(rate):.1f}" for t, rate in enumerate(curve)), y(curve[-1]))
            for name, curve in curves.items()
        ],
        x_ticks=[(x(k * gap * fps), f"{k * gap:g}") for k in range(int(seconds / gap + 1e-9) + 1)],
        y_ticks=[(y(rate), f"{100 * rate:.0f}") for rate in (0, 0.25, 0.5, 0.75, 1)],
    )
