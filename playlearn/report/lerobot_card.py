"""The card of a LeRobot dataset, as the Hub reads it: YAML, then Markdown; and its picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from playlearn.report.play import figures
from playlearn.report.store_report import SIZES, STRIPS
from playlearn.report.strips import sheet, stored_images, strips
from playlearn.report.template import template
from playlearn.store import Store

PICTURE = "play.png"
DESCRIPTIONS = {
    "observation.state": "proprioception",
    "observation.environment_state": "objects and fixtures",
    "observation.goal.state": "objects and fixtures in the goal",
    "observation.goal.proprio": "proprioception in the goal",
    "action": "the label, without noise and mistakes",
    "intervention": "an expert took over",
    "next.success": "the goal is reached by this step",
    "next.reward": "as it was recorded",
}


def lerobot_picture(store: Store, title: str) -> bytes:
    """Film strips of attempts as PNG; empty if there are no images or no attempts."""
    if not store.cameras():
        return b""
    shown = strips(store, stored_images(store), tuple(store.cameras()), STRIPS, np.random.default_rng(0))
    return sheet(shown, title) if shown else b""


@dataclass(frozen=True)
class CardFacts:
    """Facts of a dataset that the card shows.

    title: its name.
    entries: its episodes.
    goals: whether it is relabeled.
    has_picture: whether there is a picture beside the card.
    """

    title: str
    entries: int
    goals: bool
    has_picture: bool


def lerobot_card(store: Store, features: Mapping[str, Any], fidelity: Mapping[str, str], facts: CardFacts) -> str:
    """The card as text.

    store: of the play.
    features: LeRobot's.
    fidelity: camera -> how its images read back.
    facts: of the dataset.
    """
    frames = int(store.lengths().sum())
    return template("lerobot_card.md.j2").render(
        play=figures(store),
        title=facts.title,
        size=next(name for name, below in SIZES.items() if frames < below),
        entries=facts.entries,
        frames=frames,
        goals=facts.goals,
        picture=PICTURE if facts.has_picture else "",
        fidelity=fidelity,
        columns=[
            (key, ", ".join(map(str, feature["shape"])), feature["dtype"], _description(key), feature["names"])
            for key, feature in features.items()
        ],
    )


def _description(key: str) -> str:
    return DESCRIPTIONS.get(key, "what the camera sees in the goal" if ".goal_" in key else "upright RGB")
