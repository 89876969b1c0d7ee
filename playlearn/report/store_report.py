"""What was played, written as a page, as numbers, as film strips or as a dataset card: the file's name says which."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from playlearn.config import atomic_write
from playlearn.episode import IMAGES, STORED
from playlearn.errors import RenderError, UsageError
from playlearn.report.play import figures
from playlearn.report.store_page import Shown, store_page
from playlearn.report.strips import Look, moments, sheet, stored_look, strips
from playlearn.report.template import template
from playlearn.sim.environment import Environment
from playlearn.store import Store

STRIPS, MOMENTS = 8, 24
HEIGHT = 120  # pixels of what is drawn from simulator states
SIZES = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6, "1M<n<10M": 1e7, "n>10M": np.inf}
COLUMNS = {
    "observation.state": "the robot's own body; m, rad, columns of a rotation matrix",
    "achieved": "objects and fixtures, what a goal speaks of; m, and 0 to 1 for switches",
    "sim.state": "restores the simulator exactly, to render again",
    "time": "simulated seconds",
    "action": "executed, each in [-1, 1]",
    "expert_action": "the label: what was meant, without noise and mistakes",
    "intervention": "whether an expert took over",
    "skill": "an index into the episode's `skills`: a name, then what befell the step (`place_red:open_loop:slip`)",
}


def write_report(store: Store, path: Path, build: Callable[[], Environment]) -> None:
    """Write the report to `path`, in the way that its suffix says (one of `KINDS`).

    build: makes the store's environment; asked only where the store has no images to show.

    Raises:
        UsageError: another suffix, an empty store, or no pictures where nothing else was asked for.
    """
    kind = KINDS.get(path.suffix)
    if kind is None:
        raise UsageError(f"{path}: a report is one of {', '.join(f'*{suffix}' for suffix in KINDS)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, kind(_Told(store, build)))


@dataclass
class _Told:
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
        """The same ones each time: drawn by a generator of their own."""
        rng = np.random.default_rng(0)
        try:
            look, cameras = self._look()
            shown = strips(self.store, look, cameras, STRIPS, rng)
            return Shown(shown, moments(self.store, look, cameras[0], MOMENTS, rng))
        except (RenderError, UsageError) as error:
            return Shown(note=f"No pictures: the store has none, and none can be drawn here ({error}).")

    def _look(self) -> tuple[Look, tuple[str, ...]]:
        if self.store.cameras():
            return stored_look(self.store), tuple(self.store.cameras())
        environment = self.build()

        def look(episode: int, t: int, camera: str) -> Any:
            environment.set_state(np.array(self.store.array(episode, "sim.state")[t]))
            height, width = environment.render(camera).shape[:2]
            return environment.render(camera, HEIGHT, round(HEIGHT * width / height))

        return look, environment.spec.cameras


def _page(told: _Told) -> bytes:
    return store_page(told.figures, told.title, told.pictures).encode()


def _numbers(told: _Told) -> bytes:
    return json.dumps(told.figures, indent=1).encode()


def _sheet(told: _Told) -> bytes:
    if not told.pictures.strips:
        raise UsageError(told.pictures.note or f"{told.store.name()} has no attempt that is long enough for a strip")
    return sheet(told.pictures.strips, told.title)


def _card(told: _Told) -> bytes:
    """A dataset card as the Hub reads it: YAML, then Markdown."""
    store = told.store
    keys = [*STORED.values(), *(IMAGES + camera for camera in store.cameras())]
    arrays = {key: store.array(0, key) for key in keys}
    steps = int(store.lengths().sum())
    return (
        template("store_card.md.j2")
        .render(
            told=told.figures,
            title=told.title,
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


KINDS: dict[str, Callable[[_Told], bytes]] = {".html": _page, ".json": _numbers, ".png": _sheet, ".md": _card}
