"""The report of a store: a page, numbers, film strips or a dataset card, depending on the file's suffix."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import atomic_write, make_folder
from playlearn.episode import IMAGES, STORED
from playlearn.errors import RenderError, UsageError
from playlearn.report.play import figures
from playlearn.report.store_page import Shown, store_page
from playlearn.report.strips import ImageSource, moments, sheet, stored_images, strips
from playlearn.report.template import template
from playlearn.sim.environment import Environment
from playlearn.store import Store

STRIPS, MOMENTS = 8, 24
HEIGHT = 120  # pixels of images rendered from simulator states
SIZES = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6, "1M<n<10M": 1e7, "n>10M": np.inf}
COLUMNS = {
    "observation.state": "proprioception; m, rad, columns of a rotation matrix",
    "achieved": "achieved goal: objects and fixtures; m, and 0 to 1 for switches",
    "sim.state": "restores the simulator exactly, to render again",
    "time": "simulated seconds",
    "action": "executed, each in [-1, 1]",
    "expert_action": "the label, without noise and mistakes",
    "intervention": "whether an expert took over",
    "skill": "index into the episode's `skills`: a name, then annotations of the step (`place_red:open_loop:slip`)",
}


def write_report(store: Store, path: Path, build: Callable[[], Environment]) -> None:
    """Write the report to `path`, in the format of its suffix (one of `KINDS`).

    build: makes the store's environment; called only if the store has no images.

    Raises:
        UsageError: unknown suffix, an empty store, or no images for a report that consists of images.
    """
    kind = KINDS.get(path.suffix)
    if kind is None:
        raise UsageError(f"{path}: a report is one of {', '.join(f'*{suffix}' for suffix in KINDS)}")
    make_folder(path.parent)
    atomic_write(path, kind(_Report(store, build)))


@dataclass
class _Report:
    """What all formats share; statistics and pictures are computed once."""

    store: Store
    build: Callable[[], Environment]

    @property
    def title(self) -> str:
        return Path(self.store.name()).resolve().name

    @cached_property
    def figures(self) -> dict[str, Any]:
        return figures(self.store)

    @cached_property
    def pictures(self) -> Shown:
        """The same ones each time, drawn by their own generator."""
        rng = np.random.default_rng(0)
        try:
            image_of, cameras = self._image_source()
            shown = strips(self.store, image_of, cameras, STRIPS, rng)
            return Shown(shown, moments(self.store, image_of, cameras[0], MOMENTS, rng))
        except (RenderError, UsageError) as error:
            return Shown(note=f"No pictures: the store has none, and none can be drawn here ({error}).")

    def _image_source(self) -> tuple[ImageSource, tuple[str, ...]]:
        if self.store.cameras():
            return stored_images(self.store), tuple(self.store.cameras())
        environment = self.build()

        def image_of(episode: int, t: int, camera: str) -> Any:
            environment.set_state(np.array(self.store.array(episode, "sim.state")[t]))
            height, width = environment.render(camera).shape[:2]
            return environment.render(camera, HEIGHT, round(HEIGHT * width / height))

        return image_of, environment.spec.cameras


def _page(report: _Report) -> bytes:
    return store_page(report.figures, report.title, report.pictures).encode()


def _numbers(report: _Report) -> bytes:
    return json.dumps(report.figures, indent=1).encode()


def _sheet(report: _Report) -> bytes:
    if not report.pictures.strips:
        raise UsageError(
            report.pictures.note or f"{report.store.name()} has no attempt that is long enough for a strip"
        )
    return sheet(report.pictures.strips, report.title)


def _card(report: _Report) -> bytes:
    """A dataset card as the Hub reads it: YAML, then Markdown."""
    store = report.store
    keys = [*STORED.values(), *(IMAGES + camera for camera in store.cameras())]
    arrays = {key: store.array(0, key) for key in keys}
    steps = int(store.lengths().sum())
    return (
        template("store_card.md.j2")
        .render(
            play=report.figures,
            title=report.title,
            size=next(name for name, below in SIZES.items() if steps < below),
            columns=[
                (key, _shape(key, array.shape), array.dtype, COLUMNS.get(key, "upright RGB"))
                for key, array in arrays.items()
            ],
        )
        .encode()
    )


def _shape(key: str, shape: tuple[int, ...]) -> str:
    rows = "T" if key in ("action", "expert_action", "intervention", "skill") else "T+1"
    return ", ".join([rows, *map(str, shape[1:])])


KINDS: dict[str, Callable[[_Report], bytes]] = {".html": _page, ".json": _numbers, ".png": _sheet, ".md": _card}
