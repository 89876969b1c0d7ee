"""One episode as a picture, to inspect its settled moments: when, what changed, and for how long."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from playlearn.config import make_folder
from playlearn.episode import IMAGES, Array
from playlearn.layout import ObjectLayout
from playlearn.quantity import continuous
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.relabeling.robot import RobotReader
from playlearn.relabeling.settling import thresholds
from playlearn.report.figure import save_figure
from playlearn.report.strips import COLORS, mark_name
from playlearn.store import Store

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FRAMES = 12  # in the strip; with more moments only every second, third ... is shown
WIDTH, LEFT, RIGHT, TOP, BOTTOM = 15.0, 0.9, 0.8, 0.4, 0.5  # inches
PALETTE = ("#2f6bdb", "#d98a1f", "#3a9d5d", "#9248c4", "#c8453b", "#5a6270", "#1aa6b7", "#b5739d")
HOLD, CHANGED = "#e9edf3", "#f6dfb8"


@dataclass(frozen=True, eq=False)
class CurveGroup:
    """Curves of one group.

    group: an object, or another group of dimensions.
    names: k names.
    values: (T+1, k) differences from the start, in units of the threshold of change.
    """

    group: str
    names: tuple[str, ...]
    values: Array

    @property
    def moved(self) -> bool:
        return bool((np.abs(self.values) > 1).any())


def timeline(store: Store, episode: int, out: Path, settling: SettlingConfig | None = None) -> Path:
    """Write the `drawing` of an episode as PNG; returns `out`.

    Raises:
        StoreError: there is no such episode.
    """
    figure = drawing(store, episode, settling or SettlingConfig())
    make_folder(out.parent)
    save_figure(figure, out, dpi=110)
    return out


def drawing(store: Store, episode: int, settling: SettlingConfig) -> "Figure":
    """Frames at an episode's settled moments, skills, and what moved.

    A settled moment is a line through all curves. The state after it is shaded for as long as it lasts, amber in the
    group that changed. Curves are distances from the start, in thresholds of change; a group that never changed is a
    thin strip.
    """
    from matplotlib.figure import Figure

    index = RelabelIndex.of_store(store, settling, episodes=[episode])
    time = store.array(episode, "time")
    seconds = time - time[0]
    moments, ends = index.settled(0)
    groups = np.array(index.groups())
    changed = [groups[row].tolist() for row in index.changed_groups()]
    curve_groups = _curve_groups(store, episode, settling)
    camera = next(iter(store.cameras()), None)
    heights = [
        *([] if camera is None else [1.35]),
        0.5,
        0.3,
        *(0.75 if group_curves.moved else 0.22 for group_curves in curve_groups),
    ]
    total = sum(heights) + TOP + BOTTOM
    figure = Figure(figsize=(WIDTH, total))
    rows = figure.subplots(len(heights), 1, height_ratios=heights)
    figure.subplots_adjust(LEFT / WIDTH, BOTTOM / total, 1 - RIGHT / WIDTH, 1 - TOP / total, hspace=0.12)
    shown = range(0, len(moments), math.ceil(len(moments) / FRAMES) or 1)
    at = [0, *(int(moments[k]) for k in shown)]
    labels = ["begin", *(f"{seconds[moments[k]]:.1f} s: {' + '.join(changed[k])}" for k in shown)]
    centers = (np.arange(len(at)) + 0.5) / max(len(at), 7)  # the center of each frame, as a fraction of the width
    fan, skills, *curves = rows if camera is None else rows[1:]
    if camera is not None:
        _frames(rows[0], store.array(episode, IMAGES + camera)[at], centers)
    _fan(fan, labels, centers, seconds[at] / seconds[-1])
    _skills(skills, seconds, store.meta(episode).annotations(), store.array(episode, "skill"))
    for axes, group_curves in zip(curves, curve_groups, strict=True):
        for moment, end, each in zip(seconds[moments], seconds[ends], changed, strict=True):
            own = group_curves.group in each
            axes.axvspan(moment, end, color=CHANGED if own else HOLD, lw=0, zorder=0)
            axes.axvline(moment, color="black", lw=1.2 if own else 0.4, zorder=1)
        _curves(axes, seconds, group_curves)
    curves[-1].tick_params(labelbottom=True)
    curves[-1].set_xlabel("seconds")
    name = f"{Path(store.name()).name}, episode {store.indices()[episode]}"
    title = f"{name}: {len(moments)} settled moments"
    legend = "curves: distance from the start, 1 is a change; shaded: settled; amber: the group that changed"
    figure.text(LEFT / WIDTH, 1 - 0.08 / total, title, va="top", fontsize=11)
    figure.text(1 - RIGHT / WIDTH, 1 - 0.1 / total, legend, va="top", ha="right", fontsize=8, color="#5a6270")
    return figure


def _curve_groups(store: Store, episode: int, settling: SettlingConfig) -> list[CurveGroup]:
    """Curves for each group of achieved dimensions, and for gripper and arm."""
    spec, episodes = store.spec, range(len(store))
    names, measured = spec.achieved_names, spec.quantities.of("achieved", len(spec.achieved_names))
    settling = settling.measured((store.array(i, "achieved") for i in episodes), names, measured, spec.fps)
    unit = thresholds(settling.change, names, measured, "change")
    curve_groups = _grouped(continuous(store.array(episode, "achieved"), measured), names, unit)
    states = [store.array(i, "observation.state") for i in episodes]
    measured = spec.quantities.of("state", len(spec.state_names))
    robot = RobotReader.measured(states, spec.state_names, measured, spec.fps, settling.robot)
    for group, columns, unit in (("gripper", robot.gripper, np.array([robot.opens])), ("arm", robot.arm, robot.moves)):
        axes = ObjectLayout([spec.state_names[k] for k in columns]).axes
        if columns:
            curve_groups.append(CurveGroup(group, axes, _scaled(states[episode][:, columns], unit)))
    return curve_groups


def _grouped(values: Array, names: Sequence[str], unit: Array) -> list[CurveGroup]:
    layout = ObjectLayout(names)
    return [
        CurveGroup(group, tuple(layout.parts[k] for k in own), _scaled(values[:, own], unit[own]))
        for group, own in layout.objects().items()
    ]


def _scaled(values: Array, unit: Array) -> Array:
    return np.asarray((values - values[0]) / unit)


def _frames(axes: "Axes", frames: Array, centers: Array) -> None:
    axes.set_axis_off()
    width = 2 * centers[0]
    for frame, center in zip(frames, centers, strict=True):
        cell = axes.inset_axes((center - 0.48 * width, 0, 0.96 * width, 1))
        cell.imshow(frame, interpolation="bilinear")
        cell.set_axis_off()


def _fan(axes: "Axes", labels: Sequence[str], centers: Array, fractions: Array) -> None:
    """Lines from each label, below its frame, to its moment."""
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.set_axis_off()
    for label, center, fraction in zip(labels, centers, fractions, strict=True):
        axes.text(center, 0.98, label, ha="center", va="top", fontsize=8)
        axes.plot((center, center, fraction), (0.62, 0.5, 0), color="black", lw=0.6)


def _skills(axes: "Axes", seconds: Array, annotations: Sequence[tuple[str, Sequence[str]]], numbers: Array) -> None:
    """A bar for each skill in its own color; below it the marks of its steps."""
    skills = [annotations[number][0] for number in numbers]
    marks = [next((mark for mark in COLORS if mark in annotations[number][1]), "") for number in numbers]
    order = list(dict.fromkeys(skills))
    for begin, end in _runs(skills):
        color = PALETTE[order.index(skills[begin]) % len(PALETTE)]
        axes.barh(0.6, seconds[end] - seconds[begin], 0.8, seconds[begin], color=color, alpha=0.35)
        axes.text(seconds[begin], 0.6, f" {skills[begin]}", va="center", fontsize=8, clip_on=True)
    for begin, end in _runs(marks):
        if marks[begin]:
            axes.barh(0.1, seconds[end] - seconds[begin], 0.2, seconds[begin], color=_color(marks[begin]))
    axes.set(xlim=(0, seconds[-1]), ylim=(0, 1), yticks=[])
    axes.set_ylabel("skill", rotation=0, ha="right", va="center", fontsize=9)
    axes.tick_params(labelbottom=False, bottom=False)
    axes.spines[:].set_visible(False)
    for k, mark in enumerate(mark for mark in COLORS if mark and mark in marks):
        axes.text(1.005, 0.9 - 0.4 * k, mark_name(mark), color=_color(mark), fontsize=7, transform=axes.transAxes)


def _curves(axes: "Axes", seconds: Array, group_curves: CurveGroup) -> None:
    for number, (name, values) in enumerate(zip(group_curves.names, group_curves.values.T, strict=True)):
        axes.plot(seconds, values, lw=1.1, color=PALETTE[number % len(PALETTE)], label=name)
    axes.set(xlim=(0, seconds[-1]))
    axes.set_ylabel(group_curves.group, rotation=0, ha="right", va="center", fontsize=9)
    axes.tick_params(labelbottom=False, bottom=False, labelsize=6)
    axes.spines[["top", "right", "bottom"]].set_visible(False)
    if not group_curves.moved:
        axes.set(yticks=[], ylim=(-1, 1))
        return
    low, high = float(group_curves.values.min()), float(group_curves.values.max())
    step = max(1, math.ceil((high - low) / 4))
    axes.set_yticks(np.arange(math.floor(low / step), math.ceil(high / step) + 1) * step)
    axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    axes.grid(axis="y", color="#c9ced6", lw=0.5)
    axes.legend(
        loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=6, frameon=False, handlelength=1, labelspacing=0.2
    )


def _color(mark: str) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in COLORS[mark])


def _runs(values: Sequence[str]) -> list[tuple[int, int]]:
    """(first, one past the last) of each run of equal values."""
    bounds = [0, *(k for k in range(1, len(values)) if values[k] != values[k - 1]), len(values)]
    return list(pairwise(bounds))
