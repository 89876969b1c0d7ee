"""How well settled moments are found without `achieved`: precision and recall against those that it shows.

The truth is what the index finds in `achieved`, lamps and levers apart as well: a change of `SMALL` things alone, which
a hand makes in passing. The two readings are those of `relabeling/robot.py`.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from PIL import Image, ImageDraw

from playlearn.bench.base import Figure, Size, measuring
from playlearn.episode import IMAGES, Array
from playlearn.errors import UsageError
from playlearn.relabeling import ImagesConfig, RelabelIndex, SettlingConfig
from playlearn.store import Store, open_store

NEAR_SECONDS = 0.5
SMALL = ("lever", "led", "bulb", "button*")
AROUND = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)  # seconds of a miss that the picture shows
MISSES = 24  # rows of the picture


@dataclass(frozen=True)
class Agreement:
    """Moments found (F) against true configurations (M) of a store.

    near: (F,) whether a true moment is near.
    found: (M,) whether a moment found is near the true one.
    shows: (F,) whether each shows a configuration that none before it showed.
    shown: (M,) whether each configuration is shown.
    small: (M,) whether only lamps and levers had changed.
    missed: (episode, moment) of each configuration that is not shown.
    false: (episode, moment) of each moment that shows none.
    """

    near: Array
    found: Array
    shows: Array
    shown: Array
    small: Array
    missed: list[tuple[int, int]]
    false: list[tuple[int, int]]


def settling(size: Size) -> Iterator[Figure]:
    """Of the store in `size.store`, from the robot and, where its cameras are named, from the images."""
    store = checked(size)
    truth = RelabelIndex.of_store(store, SettlingConfig())
    rows: list[Array] = []
    sources = {"robot": SettlingConfig(source="robot")}
    if size.cameras:
        sources["images"] = SettlingConfig(source="images", images=ImagesConfig(size.cameras))
    for source, config in sources.items():
        measuring(f"settled, {source}")
        began = time.perf_counter()
        found = RelabelIndex.of_store(store, config)
        seconds = time.perf_counter() - began
        agreed = agreement(truth, found)
        for name, value in {
            "precision by moments": agreed.near,
            "recall by moments": agreed.found,
            "precision by configurations": agreed.shows,
            "recall by configurations": agreed.shown,
            "recall of objects": agreed.shown[~agreed.small],
            "recall of lamps and levers": agreed.shown[agreed.small],
        }.items():
            if len(value):
                yield Figure(f"{source}: {name}", 100 * float(value.mean()), "%")
        yield Figure(f"{source}: moments", float(len(agreed.near)), f"of {len(agreed.shown)}")
        yield Figure(f"{source}: index of {len(store)} episodes", seconds, "s")
        rows = [*_rows(store, agreed.missed, "missed", source, size.cameras), *rows]
        rows += _rows(store, agreed.false, "false", source, size.cameras)
    if size.picture is not None and rows:
        Image.fromarray(np.concatenate(rows)).save(size.picture)


def checked(size: Size) -> Store:
    """The store to measure on.

    Raises:
        UsageError: none is named, it records no `achieved`, or lacks a camera.
    """
    if size.store is None:
        raise UsageError("bench settled: name the play to measure on, --store STORE")
    store = open_store(size.store)
    if not store.spec.achieved_names:
        raise UsageError(f"bench settled: {store.name()} records no `achieved` to compare with")
    if size.cameras:
        ImagesConfig(size.cameras).chosen(tuple(store.cameras()))
    return store


def agreement(truth: RelabelIndex, found: RelabelIndex) -> Agreement:
    """How moments found agree with the true ones, episode by episode."""
    slack = round(NEAR_SECONDS * truth.fps)
    near: list[bool] = []
    back: list[bool] = []
    shows: list[bool] = []
    shown: list[bool] = []
    missed, false = [], []
    for episode in range(len(truth.lengths)):
        (moments, ends), own = (part.tolist() for part in truth.settled(episode)), found.settled(episode)[0].tolist()
        near += [any(abs(t - m) <= slack for m in moments) for t in own]
        back += [any(abs(t - m) <= slack for t in own) for m in moments]
        which = _shown(own, moments, ends, slack)
        shows += [k is not None for k in which]
        shown += [k in which for k in range(len(moments))]
        missed += [(episode, m) for k, m in enumerate(moments) if k not in which]
        false += [(episode, t) for t, k in zip(own, which, strict=True) if k is None]
    groups = [any(fnmatchcase(group, pattern) for pattern in SMALL) for group in truth.groups()]
    small = np.asarray(~truth.changed_groups()[:, ~np.array(groups, np.bool_)].any(axis=1))
    return Agreement(np.array(near), np.array(back), np.array(shows), np.array(shown), small, missed, false)


def _shown(found: Sequence[int], moments: Sequence[int], ends: Sequence[int], slack: int) -> list[int | None]:
    """Which configuration each moment found shows: the first that lasts until then and that none before it showed."""
    which: list[int | None] = []
    k = 0
    for t in found:
        while k < len(moments) and ends[k] + slack < t:
            k += 1
        shows = k < len(moments) and moments[k] - slack <= t
        which.append(k if shows else None)
        k += shows
    return which


def _rows(
    store: Store, misses: Sequence[tuple[int, int]], what: str, source: str, cameras: Sequence[str]
) -> list[Array]:
    """A row of frames around each of some misses, evenly chosen."""
    camera = next(iter(cameras or store.cameras()), None)
    if camera is None:
        return []
    chosen = (
        [misses[k] for k in np.unique(np.linspace(0, len(misses) - 1, MISSES // 2).round().astype(int))]
        if misses
        else []
    )
    return [
        _row(store.array(episode, IMAGES + camera), t, store.spec.fps, f"{source} {what} {episode}:{t}")
        for episode, t in chosen
    ]


def _row(frames: Array, t: int, fps: float, text: str) -> Array:
    at = [min(max(t + round(seconds * fps), 0), len(frames) - 1) for seconds in AROUND]
    row = Image.fromarray(np.concatenate([frames[k].repeat(2, axis=0).repeat(2, axis=1) for k in at], axis=1))
    ImageDraw.Draw(row).text((2, 2), text, fill=(255, 0, 0))
    return np.asarray(row)
