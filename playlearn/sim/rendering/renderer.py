"""Images of a scene, quickly: no more is drawn than they can show, four samples a pixel, one GL context a process.

What costs time on a CPU is vertices, textured surfaces behind others, the sky and reflections; updating the scene
and reading the image cost next to nothing. So meshes are simplified to the size of the image (`simplify`), what is
out of view or covered is left out (`culling`), what stands still before a fixed camera is drawn once, and
reflections, of which robosuite's floor has one in a hundred, not at all.
"""

import sys
from collections.abc import Callable
from typing import Any

import mujoco
import numba
import numpy as np

from playlearn.episode import Array
from playlearn.sim.rendering.culling import Culling
from playlearn.sim.rendering.gl import our_context
from playlearn.sim.rendering.simplify import FINEST, VISUAL_GROUP, simplified_model


class Renderer:
    """Draws a scene in any state, from any camera, in any size; holds its own data, never the simulation's.

    scene: makes the scene, new each time.
    home: (nq,), a pose from which to estimate how near the cameras come to objects.
    paint: called with a model and what an environment keeps beside MuJoCo's state, to show it: it may change colors
        and the places of bodies.
    """

    def __init__(
        self, scene: Callable[[], mujoco.MjSpec], home: Array, paint: Callable[[mujoco.MjModel, Array], None]
    ) -> None:
        self._scene, self._home, self._paint = scene, np.array(home), paint
        self._stages: dict[int, _Stage] = {}

    def draw(self, qpos: Array, extra: Array, camera: str, height: int, width: int) -> Array:
        """(h, w, 3) uint8, upright; the image depends on nothing but these arguments.

        Raises:
            RenderError: no headless OpenGL can be had; the message says what to install.
        """
        return self._stage(height).draw(qpos, extra, camera, height, width)

    def _stage(self, height: int) -> "_Stage":
        rows = 64
        while rows < height and rows <= FINEST:
            rows *= 2
        if rows not in self._stages:
            with our_context():  # raises where it is missing, before time is spent
                pass
            self._stages[rows] = _Stage(simplified_model(self._scene(), self._home, rows), self._paint)
        return self._stages[rows]


class _Stage:
    """A compiled scene and what it takes to draw it."""

    def __init__(self, model: mujoco.MjModel, paint: Callable[[mujoco.MjModel, Array], None]) -> None:
        self._context: mujoco.MjrContext | None = None
        self._model, self._data, self._paint = model, mujoco.MjData(model), paint
        self._visual = model.geom_group == VISUAL_GROUP
        self._moves = model.body_weldid[model.geom_bodyid] != 0
        room = self._visual & (model.geom_bodyid == 0)
        self._cover = Culling(model, room, self._visual & ~room & ~self._moves)
        self._moving = np.flatnonzero(self._visual & self._moves)
        self._material = model.geom_matid[self._moving]
        self._fixed_camera = model.body_weldid[model.cam_bodyid] == 0
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[VISUAL_GROUP] = 1
        self._option.sitegroup[:] = 0
        self._scene = mujoco.MjvScene(model, maxgeom=2000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._size = (0, 0)
        self._posed: bytes | None = None
        self._painted: bytes | None = None
        self._look, self._opaque = b"", False
        self._backgrounds: dict[tuple[int, int, int], tuple[bytes, Array, Array]] = {}

    def draw(self, qpos: Array, extra: Array, camera: str, height: int, width: int) -> Array:
        self._pose(qpos, extra)
        fine, image = np.empty((2 * height, 2 * width, 3), np.uint8), np.empty((height, width, 3), np.uint8)
        with our_context():
            self._draw(self._model.camera(camera).id, fine)
        _halve(fine, image)
        return image

    def _pose(self, qpos: Array, extra: Array) -> None:
        """Put everything in place, unless it is there already: most states are seen by more than one camera."""
        model, data, painted, posed = self._model, self._data, extra.tobytes(), qpos.tobytes()
        if painted == self._painted and posed == self._posed:
            return
        if painted != self._painted:
            self._paint(model, extra)
            self._look = b"".join(
                values.tobytes()
                for values in (model.body_pos, model.body_quat, model.geom_rgba, model.mat_rgba, model.mat_emission)
            )
            self._opaque = self._is_opaque()
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._painted, self._posed = painted, posed

    def _is_opaque(self) -> bool:
        """Whether what stands still can be drawn by itself: nothing clear before it, no shadow thrown on it."""
        model = self._model
        alpha = np.where(self._material >= 0, model.mat_rgba[self._material, 3], model.geom_rgba[self._moving, 3])
        return not ((alpha > 0) & (alpha < 1)).any() and not model.light_castshadow.any()

    def _draw(self, camera: int, fine: Array) -> None:
        """Fill fine (H, W, 3), bottom row first."""
        height, width, _ = fine.shape
        if self._fixed_camera[camera] and self._opaque:
            behind, far = self._background(camera, height, width)
            depth = np.empty((height, width), np.float32)
            self._shoot(camera, self._visual & self._moves, False, fine, depth)
            _put_before(fine, depth, behind, far)
        else:
            self._shoot(camera, self._visual, True, fine, None)

    def _background(self, camera: int, height: int, width: int) -> tuple[Array, Array]:
        """All that stands still, as a fixed camera sees it: image and depth, drawn anew when `paint` changed it."""
        kept = self._backgrounds.get((camera, height, width))
        if kept is None or kept[0] != self._look:
            image, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
            self._shoot(camera, self._visual & ~self._moves, True, image, depth)
            kept = self._backgrounds[camera, height, width] = self._look, image, depth
        return kept[1:]

    def _shoot(self, camera: int, geoms: Array, sky: bool, image: Array, depth: Array | None) -> None:
        """Fill image (H, W, 3) and depth (H, W), 0 near .. 1 nothing, with these geoms (g,) bool; bottom row first."""
        height, width, _ = image.shape
        context = self._need(height, width)
        self._view.fixedcamid = camera
        seen, above = self._cover.seen(self._data, camera, width / height)
        if self._model.light_castshadow.any():  # what is out of view may throw one into it
            seen = self._visual
        self._model.geom_group[:] = np.where(geoms & seen, VISUAL_GROUP, mujoco.mjNGROUP - 1)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = sky and above
        every = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._view, every, self._scene)
        rectangle = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rectangle, self._scene, context)
        mujoco.mjr_readPixels(image, depth, rectangle, context)

    def _need(self, height: int, width: int) -> mujoco.MjrContext:
        if self._context is None or height > self._size[0] or width > self._size[1]:
            self._size = max(height, self._size[0]), max(width, self._size[1])
            self._model.vis.global_.offheight, self._model.vis.global_.offwidth = self._size
            if self._context is not None:
                self._context.free()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
            _sample_one_level(self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)  # each context has its own
        return self._context

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing) -> None:
        # at the interpreter's end this module's own names are gone, and the process takes its contexts along
        if self._context is not None and not is_finalizing():
            with our_context():
                self._context.free()


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _put_before(image: Any, depth: Any, behind: Any, far: Any) -> None:
    """Fill `image` with what is behind it, wherever that is not farther."""
    for y in range(len(depth)):
        for x in range(depth.shape[1]):
            if depth[y, x] >= far[y, x]:
                for c in range(3):
                    image[y, x, c] = behind[y, x, c]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _halve(fine: Any, image: Any) -> None:
    """Mean over 2 x 2 pixels of (2 h, 2 w, 3), whose rows go bottom-up as OpenGL's do, into (h, w, 3)."""
    height, width, _ = image.shape
    for y in range(height):
        low = 2 * (height - 1 - y)
        for x in range(width):
            for c in range(3):
                total = np.int32(fine[low, 2 * x, c]) + fine[low, 2 * x + 1, c]
                total += np.int32(fine[low + 1, 2 * x, c]) + fine[low + 1, 2 * x + 1, c]
                image[y, x, c] = (total + 2) >> 2


def _sample_one_level(context: mujoco.MjrContext) -> None:
    """Textures from the nearest of their sizes, not blended from two: a fifth of the time, and nothing to be seen."""
    from OpenGL import GL

    for name, kind in zip(context.texture[: context.ntexture], context.textureType, strict=False):
        target = GL.GL_TEXTURE_2D if kind == mujoco.mjtTexture.mjTEXTURE_2D else GL.GL_TEXTURE_CUBE_MAP
        GL.glBindTexture(target, int(name))
        GL.glTexParameteri(target, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_NEAREST)
        GL.glBindTexture(target, 0)
