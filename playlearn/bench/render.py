"""Images a second of our renderer, beside robosuite's, and the similarity of images."""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from playlearn.bench.base import Figure, Size, measuring, rates
from playlearn.bench.envs import SEED, SIDE, Pair, actions, pairs
from playlearn.config import make_folder
from playlearn.episode import Array
from playlearn.report.figure import save_picture
from playlearn.sim.rendering.simplify import VISUAL_GROUP

FINE = 8  # the full-quality image is rendered at so many times the size and averaged down
COLLISION_GROUP = 0
COMPARED = 8  # states whose images are compared


def rendering(size: Size) -> Iterator[Figure]:
    """PlayTable and Lift, two cameras of SIDE pixels, one process.

    The limit renders collision geoms only, without shadows. The last figures are SSIM (1: identical) between our image
    and the full scene, rendered at FINE times the size with every face, multisampling and shadows, averaged down.
    """
    for pair in pairs(size.envs, images=True):
        measuring(f"{pair.name}: two {SIDE}x{SIDE} images")
        states = _walk(pair, size.steps)
        bare = _Plain(pair, COLLISION_GROUP, SIDE)
        measured = rates(
            {
                "ours": partial(_ours, pair, states),
                "peer": partial(_peer, pair, states[: max(4, len(states) // 10)]),
                "limit": partial(bare.measure, states),
            },
            size.rounds,
        )
        yield Figure.beside(
            f"{pair.name}: two {SIDE}x{SIDE} images",
            "images/s",
            measured,
            "robosuite render",
            "collision geoms only",
        )
        measuring(f"{pair.name}: similarity")
        yield from _similarity(pair, states, size.out)


def ssim(one: Array, other: Array) -> float:
    """Structural similarity of two (h, w, 3) uint8 images (Wang et al. 2004; Gaussian window of 1.5 pixels)."""

    def blurred(values: Array) -> Array:
        smooth: Array = gaussian_filter(values, (1.5, 1.5, 0), truncate=3.5)
        return smooth

    a, b = one.astype(float), other.astype(float)
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    mean_a, mean_b = blurred(a), blurred(b)
    var_a, var_b = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2
    both = blurred(a * b) - mean_a * mean_b
    similarity = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return float(similarity.mean())


def _walk(pair: Pair, steps: int) -> list[Array]:
    """Simulator states of our environment along random actions."""
    pair.ours.reset(SEED)
    states = []
    for action in actions(steps):
        pair.ours.step(action)
        states.append(pair.ours.sim_state())
    return states


def _ours(pair: Pair, states: Sequence[Array]) -> tuple[int, float]:
    seconds = 0.0
    for state in states:
        pair.ours.set_state(state)
        began = time.perf_counter()
        for camera in pair.cameras:
            pair.ours.render(camera, SIDE, SIDE)
        seconds += time.perf_counter() - began
    return len(states) * len(pair.cameras), seconds


def _peer(pair: Pair, states: Sequence[Array]) -> tuple[int, float]:
    sim, seconds = pair.peer.sim, 0.0
    for state in states:
        pair.ours.set_state(state)
        sim.data.qpos[:] = pair.ours.data.qpos
        sim.forward()
        sim._render_context_offscreen.gl_ctx.make_current()  # robosuite renders into the current context
        began = time.perf_counter()
        for camera in pair.peer_cameras:
            sim.render(camera_name=camera, width=SIDE, height=SIDE)
        seconds += time.perf_counter() - began
    return len(states) * len(pair.peer_cameras), seconds


class _Plain:
    """`mujoco.Renderer` on the whole scene, with one group of geoms; plain: no shadows, no multisampling."""

    def __init__(self, pair: Pair, group: int, side: int, *, plain: bool = True) -> None:
        self._env, self._model = pair.ours, pair.ours.scene()
        self._cameras, self._data = pair.cameras, mujoco.MjData(self._model)
        self._model.vis.global_.offwidth = self._model.vis.global_.offheight = side
        self._model.vis.quality.offsamples = 0 if plain else 4
        self._renderer: Any = mujoco.Renderer(self._model, side, side)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[group] = 1
        self._option.sitegroup[:] = 0
        if plain:
            self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0

    def image(self, camera: str) -> Array:
        """The image of the environment's present state."""
        self._place()
        return self._draw(camera)

    def measure(self, states: Sequence[Array]) -> tuple[int, float]:
        seconds = 0.0
        for state in states:
            self._env.set_state(state)
            self._place()
            began = time.perf_counter()
            for camera in self._cameras:
                self._draw(camera)
            seconds += time.perf_counter() - began
        return len(states) * len(self._cameras), seconds

    def _place(self) -> None:
        self._env.paint(self._model)
        self._data.qpos[:] = self._env.data.qpos
        mujoco.mj_forward(self._model, self._data)

    def _draw(self, camera: str) -> Array:
        self._renderer.update_scene(self._data, camera, self._option)
        image: Array = self._renderer.render()
        return image


def _similarity(pair: Pair, states: Sequence[Array], out: Path | None) -> Iterator[Figure]:
    fine = _Plain(pair, VISUAL_GROUP, FINE * SIDE, plain=False)
    chosen = [states[i] for i in np.unique(np.linspace(0, len(states) - 1, COMPARED).astype(int))]
    strips = []
    for camera in pair.cameras:
        ours, full = [], []
        for state in chosen:
            pair.ours.set_state(state)
            ours.append(pair.ours.render(camera, SIDE, SIDE))
            full.append(_averaged(fine.image(camera)))
        mean = float(np.mean([ssim(one, other) for one, other in zip(ours, full, strict=True)]))
        yield Figure(f"{pair.name}: similarity, {camera}", mean, "SSIM")
        strips += [np.concatenate(ours[:4], axis=1), np.concatenate(full[:4], axis=1)]
    if out is not None:
        make_folder(out)
        sheet = Image.fromarray(np.concatenate(strips))
        larger = sheet.resize((2 * sheet.width, 2 * sheet.height), Image.Resampling.NEAREST)
        save_picture(larger, out / f"{pair.name}.png")


def _averaged(image: Array) -> Array:
    """(FINE h, FINE w, 3) -> (h, w, 3), each pixel the mean of a block."""
    blocks = image.reshape(image.shape[0] // FINE, FINE, image.shape[1] // FINE, FINE, 3)
    mean: Array = blocks.mean(axis=(1, 3)).round().astype(np.uint8)
    return mean
