"""The card of a LeRobot dataset, as the Hub reads it: YAML, then Markdown; and its picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.report.play import figures
from playlearn.report.store_report import SIZES, STRIPS
from playlearn.report.strips import sheet, stored_look, strips
from playlearn.report.template import template
from playlearn.store import Store

PICTURE = "play.png"
WORDS = {
    "observation.state": "the robot's own body",
    "observation.environment_state": "objects and fixtures",
    "observation.goal.state": "objects and fixtures in the goal",
    "action": "the label: what was meant, without noise and mistakes",
    "intervention": "an expert took over",
    "next.success": "the goal is reached by this step",
}


def lerobot_picture(store: Store, title: str) -> bytes:
    """Film strips of what was done, PNG; empty where there are no images or nothing was named."""
    if not store.cameras():
        return b""
    shown = strips(store, stored_look(store), tuple(store.cameras()), STRIPS, np.random.default_rng(0))
    return sheet(shown, title) if shown else b""


@dataclass(frozen=True)
class CardFacts:
    """entries: episodes of the dataset. goals: it is relabeled. drawn: a picture lies beside."""

    title: str
    entries: int
    goals: bool
    drawn: bool


def lerobot_card(store: Store, features: Mapping[str, Any], fidelity: Mapping[str, str], facts: CardFacts) -> str:
    """features: LeRobot's. fidelity: camera -> how it reads back."""
    frames = int(store.lengths().sum())
    return template("lerobot_card.md.j2").render(
        told=figures(store),
        title=facts.title,
        size=next(name for name, below in SIZES.items() if frames < below),
        entries=facts.entries,
        frames=frames,
        goals=facts.goals,
        picture=PICTURE if facts.drawn else "",
        fidelity=fidelity,
        columns=[
            (key, ", ".join(map(str, feature["shape"])), feature["dtype"], _words(key), feature["names"])
            for key, feature in features.items()
        ],
    )


def _words(key: str) -> str:
    return WORDS.get(key, "what the camera sees in the goal" if ".goal_" in key else "upright RGB")
