"""Images of a MuJoCo scene exactly as `mujoco.Renderer` draws them, which OGBench's pixels are made with."""

from typing import Any

import mujoco
import numpy as np

from playlearn.episode import Array
from playlearn.sim.rendering.gl import our_context

_GEOMS = 10_000  # the most that a scene may show, `mujoco.Renderer`'s own


class Pictures:
    """Draws any state of one model; what it shows follows the model's colors of the moment."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._context: Any = None
        self._scene = mujoco.MjvScene(model, maxgeom=_GEOMS)
        self._size = (0, 0)

    def draw(self, data: mujoco.MjData, camera: str, height: int, width: int) -> Array:
        """(h, w, 3) uint8, upright.

        Raises:
            RenderError: no headless OpenGL can be had; the message says what to install.
        """
        image = np.empty((height, width, 3), np.uint8)
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, int(self._model.camera(camera).id)
        mujoco.mj_comPos(self._model, data)  # a restored state has no cameras and lights yet
        mujoco.mj_camlight(self._model, data)
        with our_context():
            context = self._need(height, width)
            every = mujoco.mjtCatBit.mjCAT_ALL
            mujoco.mjv_updateScene(self._model, data, mujoco.MjvOption(), None, view, every, self._scene)
            rectangle = mujoco.MjrRect(0, 0, width, height)
            mujoco.mjr_render(rectangle, self._scene, context)
            mujoco.mjr_readPixels(image, None, rectangle, context)
        return np.ascontiguousarray(image[::-1])

    def _need(self, height: int, width: int) -> Any:
        if self._context is None or height > self._size[0] or width > self._size[1]:
            self._size = max(height, self._size[0]), max(width, self._size[1])
            self._model.vis.global_.offheight, self._model.vis.global_.offwidth = self._size
            if self._context is not None:
                self._context.free()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)  # each context has its own
        return self._context

    def __del__(self) -> None:
        if self._context is not None:
            with our_context():
                self._context.free()
