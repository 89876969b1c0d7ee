"""Play and evaluations in rerun: opened in its viewer, or written to an .rrd file without a display.

A file name that ends in .png gives the timeline of an episode as a picture (see `timeline.py`).
"""

import base64
import io
import json
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

from playlearn.config import atomic_write, make_folder
from playlearn.episode import Array, Episode
from playlearn.errors import PlaylearnError, UsageError
from playlearn.layout import ObjectLayout
from playlearn.relabeling import RelabelIndex, SettlingConfig
from playlearn.report.timeline import timeline
from playlearn.store import open_store

STILLS = ("start", "goal", "final")


def view_episode(path: Path, episode: int = 0, *, save: Path | None = None) -> Path | None:
    """Show one episode of a store: cameras, goals, state, achieved, actions, skills, settled moments.

    The goal beside each camera is the next settled moment, as relabeling would choose it. Returns the .rrd file if one
    was written (`save`, or no display), else None. A `save` that ends in .png is the episode's timeline as a picture.

    Raises:
        StoreError: there is no such store or episode.
        PlaylearnError: the viewer does not start.
    """
    store = open_store(path)
    play = store.read(episode)
    if save is not None and save.suffix == ".png":
        print(f"wrote {timeline(store, episode, save)}")
        return save
    table = RelabelIndex.of_store(store, SettlingConfig(), episodes=[episode])
    name = f"{Path(path).resolve().name}-episode-{episode}"
    return _show(name, _episode_layout(play), lambda recording: _log_episode(recording, play, table), save)


def view_results(folder: Path, *, save: Path | None = None) -> Path | None:
    """Show an evaluation: for every episode the goal beside what was achieved, and pictures if there are any.

    Raises:
        UsageError: the folder holds no evaluation.
        PlaylearnError: the viewer does not start.
    """
    try:
        results = json.loads((folder / "results.json").read_text())
        rows = pq.read_table(folder / "episodes.parquet").to_pylist()
        policy = results["policy"]["name"]
        names = tuple(results.get("achieved_names", ()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{folder} is not an evaluation ({error}): give the --out folder of `playlearn eval`"
        ) from error
    rows = sorted(
        (row for row in rows if row["policy"] == policy), key=lambda row: (row["episode"], row.get("goal_index", 0))
    )
    rows = list({row["episode"]: row for row in rows}.values())  # of a chain the last attempted goal
    pictures = _pictures(folder / "report.html")
    layout = rrb.Vertical(
        rrb.Horizontal(*(rrb.Spatial2DView(origin=f"pictures/{still}", name=still) for still in STILLS)),
        rrb.Horizontal(rrb.TextDocumentView(origin="outcome"), rrb.TimeSeriesView(origin="success")),
    )
    name = f"{folder.resolve().name}-results"
    return _show(name, layout, lambda recording: _log_results(recording, rows, names, pictures), save)


def _show(
    name: str, layout: rrb.Container, log: Callable[[rr.RecordingStream], None], save: Path | None
) -> Path | None:
    """Send what `log` logs to the viewer, or to a file if `save` is given or there is no display."""
    recording = rr.RecordingStream("playlearn")
    recording.send_recording_name(name)
    if save is None and _has_display():
        try:
            recording.spawn(default_blueprint=rrb.Blueprint(layout))
        except (RuntimeError, OSError) as error:
            raise PlaylearnError(
                f"rerun's viewer does not start ({error}): write a file with --save FILE.rrd"
            ) from error
        log(recording)
        recording.flush()
        return None
    out = save or Path(f"{name}.rrd")
    in_memory = recording.memory_recording()  # a sink that is a file says nothing where the disk is full
    recording.send_blueprint(rrb.Blueprint(layout), make_active=False, make_default=True)
    log(recording)
    make_folder(out.parent)
    atomic_write(out, in_memory.drain_as_bytes())
    recording.disconnect()
    print(f"wrote {out}; open it on a machine with a display: rerun {out}")
    return out


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _episode_layout(play: Episode) -> rrb.Container:
    groups = ObjectLayout(play.meta.achieved_names).objects()
    cameras = [
        rrb.Horizontal(
            rrb.Spatial2DView(origin=f"camera/{camera}", name=camera),
            rrb.Spatial2DView(origin=f"goal/{camera}", name=f"{camera}: next settled moment"),
        )
        for camera in play.images
    ]
    curves = [
        rrb.TimeSeriesView(origin="action", name="action"),
        rrb.TimeSeriesView(origin="state", name="state"),
        *(rrb.TimeSeriesView(origin=f"achieved/{group}", name=group) for group in groups),
    ]
    return rrb.Horizontal(
        rrb.Vertical(*cameras, rrb.TextLogView(origin="events", name="skills and settled moments")),
        rrb.Grid(*curves),
    )


def _log_episode(recording: rr.RecordingStream, play: Episode, table: RelabelIndex) -> None:
    meta, steps = play.meta, len(play)
    seconds = play.time - play.time[0]

    def index(rows: Sequence[int] | Array) -> list[rr.TimeColumn]:
        chosen = np.asarray(rows)
        return [rr.TimeColumn("step", sequence=chosen), rr.TimeColumn("time", duration=seconds[chosen])]

    def curves(path: str, values: Array, names: Sequence[str]) -> None:
        recording.log(path, rr.SeriesLines(names=list(names)), static=True)
        recording.send_columns(path, index(np.arange(len(values))), rr.Scalars.columns(scalars=values))

    curves("state", play.state, meta.state_names)
    curves("action/executed", play.action, meta.action_names)
    curves("action/label", play.expert_action, [f"{name} (label)" for name in meta.action_names])
    for group, own in ObjectLayout(meta.achieved_names).objects().items():
        curves(f"achieved/{group}", play.achieved[:, own], [meta.achieved_names[k] for k in own])
    if play.intervention.any():
        curves("action/intervention", play.intervention[:, None].astype(np.float32), ["intervention"])

    moments, _ = table.settled(0)
    changed = [", ".join(np.array(table.groups())[row]) for row in table.changed_groups()]
    begins = np.flatnonzero(np.diff(play.skill, prepend=-1))
    events = [(int(t), meta.skills[play.skill[t]]) for t in begins if meta.skills]
    events += [(int(t), f"settled: {what} changed") for t, what in zip(moments, changed, strict=True)]
    events.append((steps, f"ended: {meta.ended}"))
    events.sort(key=lambda event: event[0])
    recording.send_columns(
        "events", index([t for t, _ in events]), rr.TextLog.columns(text=[what for _, what in events])
    )

    # The goal is the next settled moment; after the last there is none.
    since = [0, *moments[:-1].tolist()][: len(moments)]
    for camera, frames in play.images.items():
        _log_frames(recording, f"camera/{camera}", frames, index(np.arange(len(frames))))
        if len(moments):
            _log_frames(recording, f"goal/{camera}", frames[moments], index(since))
            recording.send_columns(f"goal/{camera}", index(moments[-1:]), rr.Clear.columns(is_recursive=[False]))


def _log_frames(recording: rr.RecordingStream, path: str, frames: Array, index: list[rr.TimeColumn]) -> None:
    """Frames (n, h, w, 3) uint8 at n times."""
    n, height, width, _ = frames.shape
    image = rr.components.ImageFormat(width=width, height=height, color_model="RGB", channel_datatype="U8")
    columns = rr.Image.columns(buffer=frames.reshape(n, -1), format=[image] * n)
    recording.send_columns(path, index, columns)


def _log_results(
    recording: rr.RecordingStream,
    rows: Sequence[Mapping[str, Any]],
    names: Sequence[str],
    pictures: Mapping[int, Mapping[str, Array]],
) -> None:
    recording.log("success", rr.SeriesPoints(names=["success"]), static=True)
    for row in rows:
        episode = int(row["episode"])
        recording.set_time("episode", sequence=episode)
        recording.log("success", rr.Scalars([float(row["success"])]))
        recording.log("outcome", rr.TextDocument(_outcome(row, names), media_type="text/markdown"))
        for still in STILLS:
            shown = pictures.get(episode, {}).get(still)
            recording.log(f"pictures/{still}", rr.Clear(recursive=False) if shown is None else rr.Image(shown))


def _outcome(row: Mapping[str, Any], names: Sequence[str]) -> str:
    """One episode in markdown: the goal beside what was achieved."""
    head = f"# {row['task']}, episode {row['episode']}\n{row['reason']} ({row['steps']} steps)\n\n"
    columns = [row[f"{still}_achieved"] or [] for still in STILLS]
    named = names if len(names) == len(columns[1]) else [str(k) for k in range(len(columns[1]))]
    lines = [
        f"| {name} | {start:.3f} | {goal:.3f} | {final:.3f} | {final - goal:+.3f} |"
        for name, start, goal, final in zip(named, *columns, strict=False)
    ]
    return head + "| | start | goal | achieved | off by |\n|---|---|---|---|---|\n" + "\n".join(lines)


def _pictures(report: Path) -> dict[int, dict[str, Array]]:
    """Episode -> still -> (h, w, 3) uint8, from the galleries of the report; empty without a report."""
    if not report.exists():
        return {}
    reader = _Gallery()
    reader.feed(report.read_text())
    return reader.pictures


class _Gallery(HTMLParser):
    """Reads each figure's `start`, `goal` and `final`, and the episode its caption names."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: dict[int, dict[str, Array]] = {}
        self._stills: dict[str, Array] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if tag == "figure":
            self._stills = {}
        elif tag == "img" and values.get("alt") in STILLS and "base64," in values.get("src", ""):
            content = base64.b64decode(values["src"].partition("base64,")[2])
            self._stills[values["alt"]] = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))

    def handle_data(self, data: str) -> None:
        named = re.search(r"\bepisode (\d+)", data)
        if named and self._stills:
            self.pictures[int(named[1])] = self._stills
            self._stills = {}
