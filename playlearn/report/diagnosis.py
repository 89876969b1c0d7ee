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
    results: Mapping[str, Any],
    descriptions: Mapping[str, str],
    strips: Mapping[str, Sequence[tuple[str, bytes]]],
    note: str,
) -> str:
    """The page as HTML.

    results: the content of diagnosis.json.
    descriptions: failure mode -> what it means.
    strips: failure mode -> captions and pictures.
    note: why there are no pictures.
    """
    return template("diagnosis.html.j2").render(results=results, descriptions=descriptions, strips=strips, note=note)


def strip(environment: Environment, sim_states: Array, goal_sim_state: Array, camera: str) -> bytes:
    """Film strip of an episode with simulator states (T+1, N): evenly spaced frames, first and last included; the goal.

    Raises:
        RenderError: there is no headless GL.
    """
    moments = np.linspace(0, len(sim_states) - 1, min(FRAMES, len(sim_states))).round().astype(int)
    own = environment.render(camera).shape
    parts: list[Array] = []
    for state in [*sim_states[moments], goal_sim_state]:
        environment.set_state(np.array(state))
        frame = environment.render(camera, HEIGHT, round(HEIGHT * own[1] / own[0]))
        parts += [frame, np.full((HEIGHT, GAP, 3), 255, np.uint8)]
    parts.insert(-2, np.full((HEIGHT, 4 * GAP, 3), 255, np.uint8))  # a gap before the goal
    return encode_still(np.concatenate(parts[:-1], axis=1))
