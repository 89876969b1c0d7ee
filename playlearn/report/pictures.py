"""Stills and short films of an episode, rendered from its simulator states."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from playlearn.episode import Array
from playlearn.sim.environment import Environment

FILM_FRAMES = 60
LAST_FRAME_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class Pictures:
    """WebP files of one episode.

    start, goal, final: stills.
    film: the episode at its own speed, with the goal beside it.
    """

    start: bytes
    goal: bytes
    final: bytes
    film: bytes | None = None


def draw(
    environment: Environment, sim_states: Array, goal_sim_state: Array, camera: str, height: int, *, film: bool
) -> Pictures:
    """Pictures of an episode with simulator states (T+1, N) towards goal_sim_state (N,).

    They are `height` pixels high and keep the camera's aspect ratio.

    Raises:
        RenderError: there is no headless GL.
    """
    own = environment.render(camera).shape
    size = height, round(height * own[1] / own[0])
    goal = _render(environment, goal_sim_state, camera, size)
    frames = None
    if film:
        # At most FILM_FRAMES, always with the first and the last.
        stride = max(1, math.ceil(len(sim_states) / FILM_FRAMES))
        moments = [*range(0, len(sim_states) - 1, stride), len(sim_states) - 1]
        views = [_render(environment, sim_states[t], camera, size) for t in moments]
        frames = encode_film([beside(view, goal) for view in views], stride / environment.spec.fps)
    return Pictures(
        start=encode_still(_render(environment, sim_states[0], camera, size)),
        goal=encode_still(goal),
        final=encode_still(_render(environment, sim_states[-1], camera, size)),
        film=frames,
    )


def beside(left: Array, right: Array, gap: int = 4) -> Array:
    """(h, w + gap + w', 3) uint8: two pictures of the same height on white."""
    return np.concatenate([left, np.full((left.shape[0], gap, 3), 255, np.uint8), right], axis=1)


def encode_still(image: Array) -> bytes:
    """(h, w, 3) uint8 as WebP."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=82)
    return buffer.getvalue()


def encode_film(frames: Sequence[Array], seconds: float) -> bytes:
    """Frames (h, w, 3) uint8, each shown for `seconds`, as a looping WebP."""
    buffer = io.BytesIO()
    pages = [Image.fromarray(frame) for frame in frames]
    shown = [round(1000 * seconds)] * (len(pages) - 1) + [round(1000 * LAST_FRAME_SECONDS)]
    pages[0].save(buffer, "WEBP", save_all=True, append_images=pages[1:], duration=shown, loop=0, quality=60, method=2)
    return buffer.getvalue()


def _render(environment: Environment, state: Array, camera: str, size: tuple[int, int]) -> Array:
    environment.set_state(np.array(state))
    return environment.render(camera, *size)
