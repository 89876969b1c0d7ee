"""A diagnosis as one self-contained page, and the film strips of failures in it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from playlearn.episode import Array
from playlearn.report.pictures import encode_still
from playlearn.report.template import template
from playlearn.sim.environment import Environment

FRAMES = 8
HEIGHT = 96  # pixels of a frame
GAP = 3


def diagnosis_page(
    results: Mapping[str, Any], words: Mapping[str, str], strips: Mapping[str, Sequence[tuple[str, bytes]]], note: str
) -> str:
    """The page as HTML. words: what each cause means. strips: cause -> captions and pictures; note: why there are none.

    results: what diagnosis.json says.
    """
    return template("diagnosis.html.j2").render(results=results, words=words, strips=strips, note=note)


def strip(environment: Environment, states: Array, goal_sim_state: Array, camera: str) -> bytes:
    """An attempt with simulator states (T+1, N): evenly spaced frames, the first and last among them, then the goal.

    Raises:
        RenderError: there is no headless GL.
    """
    moments = np.linspace(0, len(states) - 1, min(FRAMES, len(states))).round().astype(int)
    own = environment.render(camera).shape
    parts: list[Array] = []
    for state in [*states[moments], goal_sim_state]:
        environment.set_state(np.array(state))
        frame = environment.render(camera, HEIGHT, round(HEIGHT * own[1] / own[0]))
        parts += [frame, np.full((HEIGHT, GAP, 3), 255, np.uint8)]
    parts.insert(-2, np.full((HEIGHT, 4 * GAP, 3), 255, np.uint8))  # the goal stands apart
    return encode_still(np.concatenate(parts[:-1], axis=1))
