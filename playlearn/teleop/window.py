"""A window for our own images: GLFW and MuJoCo draw it, so nothing needs installing where there is a screen."""

import os
import re
import warnings
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np

from playlearn.episode import Array
from playlearn.errors import UsageError
from playlearn.teleop.device import Wish

KEYS = "Enter: keep   Backspace: throw away   Esc: leave"


class Window:
    """A `Screen` on the desktop; a context manager. Raises UsageError where there is no screen."""

    def __init__(self, title: str, height: int, width: int) -> None:
        import glfw

        self._glfw, self._size = glfw, (height, width)
        self._wish: Wish | None = None
        self._window: Any = None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            if glfw.init():
                if os.environ.get("MUJOCO_GL") == "egl":  # a thread may not hold contexts of EGL and GLX by turns
                    glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API)
                glfw.window_hint(glfw.RESIZABLE, glfw.FALSE)
                self._window = glfw.create_window(width, height, title, None, None)
        if not self._window:
            reasons = (re.sub(r"^\(\d+\) b.(.*).$", r"\1", str(warning.message)) for warning in caught)
            why = "; ".join(reasons) or "GLFW gives no reason"
            raise UsageError(
                f"a teleoperator needs to see the environment, and no window can be opened here ({why}): run this "
                "where there is a screen (over ssh: `ssh -X`), or leave out --device"
            )
        self._wishes = {
            glfw.KEY_ENTER: Wish.KEEP,
            glfw.KEY_KP_ENTER: Wish.KEEP,
            glfw.KEY_BACKSPACE: Wish.DISCARD,
            glfw.KEY_ESCAPE: Wish.LEAVE,
        }
        glfw.set_key_callback(self._window, self._pressed)
        glfw.make_context_current(self._window)
        glfw.swap_interval(0)
        self._context = mujoco.MjrContext(
            mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100
        )
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_WINDOW, self._context)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _where: TracebackType | None
    ) -> None:
        self._glfw.make_context_current(self._window)
        self._context.free()
        self._glfw.destroy_window(self._window)

    def show(self, image: Array, text: str) -> None:
        """Show an image (h, w, 3) uint8 of any size that divides the window's, and a line of text."""
        self._glfw.make_context_current(self._window)  # the renderer made its own current
        width, height = self._glfw.get_framebuffer_size(self._window)
        down, across = max(1, height // image.shape[0]), max(1, width // image.shape[1])
        large = np.ascontiguousarray(image[::-1].repeat(down, axis=0).repeat(across, axis=1))  # OpenGL's go bottom-up
        area = mujoco.MjrRect(0, 0, large.shape[1], large.shape[0])
        mujoco.mjr_drawPixels(large.reshape(-1), None, area, self._context)
        place, font = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtFont.mjFONT_NORMAL
        mujoco.mjr_overlay(font, place, area, text, "", self._context)
        mujoco.mjr_overlay(font, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT, area, KEYS, "", self._context)
        self._glfw.swap_buffers(self._window)

    def wish(self) -> Wish | None:
        self._glfw.poll_events()
        wish = Wish.LEAVE if self._glfw.window_should_close(self._window) else self._wish
        self._wish = None
        return wish

    def _pressed(self, _window: Any, key: int, _scancode: int, action: int, _modifiers: int) -> None:
        if action == self._glfw.PRESS:
            self._wish = self._wishes.get(key, self._wish)
