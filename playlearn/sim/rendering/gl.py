"""The one OpenGL context of this process, current only while it is drawn with.

Code that frees what it drew with, as robosuite does when an environment is deleted, frees it in whichever context is
current then, and an object's id in one context is an id in every other. So ours is current only while we draw,
the former one is so again afterwards, and no garbage is collected meanwhile.
"""

import atexit
import contextlib
import functools
import gc
import importlib
import os
import sys
from collections.abc import Iterator
from typing import Any

from playlearn.errors import RenderError


@contextlib.contextmanager
def our_context() -> Iterator[None]:
    """Make it current.

    Raises:
        RenderError: no headless OpenGL can be had; the message says what to install.
    """
    if sys.is_finalizing():
        yield
        return
    egl = os.environ.setdefault("MUJOCO_GL", "egl").lower() == "egl"
    collecting = gc.isenabled()
    gc.disable()
    try:
        with _current_again() if egl else contextlib.nullcontext():
            _context().make_current()
            yield
    finally:
        if collecting:
            gc.enable()


def backend() -> str:
    """GL back end and device, such as `egl: llvmpipe (LLVM 15.0.6, 256 bits)`."""
    with our_context():
        from OpenGL import GL  # only once a platform has been chosen by the context

        while GL.glGetError():  # an error of before is none of this question
            pass
        return f"{os.environ.get('MUJOCO_GL', 'default')}: {GL.glGetString(GL.GL_RENDERER).decode()}"


@contextlib.contextmanager
def _current_again() -> Iterator[None]:
    """The EGL context that is current, or none, is so again at the end."""
    try:
        from mujoco.egl import egl_ext
    except Exception:  # noqa: BLE001 - there is no EGL, of which `_context` speaks
        yield
        return
    former = egl_ext.eglGetCurrentContext()
    if former:
        display = egl_ext.eglGetCurrentDisplay()
        surfaces = [egl_ext.eglGetCurrentSurface(kind) for kind in (egl_ext.EGL_DRAW, egl_ext.EGL_READ)]
    try:
        yield
    finally:
        if former:
            egl_ext.eglMakeCurrent(display, *surfaces, former)
        elif display := egl_ext.eglGetCurrentDisplay():
            nothing = egl_ext.EGL_NO_SURFACE, egl_ext.EGL_NO_SURFACE, egl_ext.EGL_NO_CONTEXT
            egl_ext.eglMakeCurrent(display, *nothing)


@functools.cache
def _context() -> Any:
    platform = os.environ.setdefault("MUJOCO_GL", "egl").lower()
    try:
        # Not `mujoco.gl_context`, which chose when mujoco was first imported, perhaps before we could say egl.
        name = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa"}.get(platform, "mujoco.gl_context")
        context = importlib.import_module(name).GLContext(64, 64)
        context.make_current()
    except Exception as error:
        raise RenderError(
            f"no headless OpenGL ({error}): install it with `apt-get install libegl1 libgl1-mesa-dri`, "
            "or collect without images and render where there is one; `playlearn doctor` checks"
        ) from error
    atexit.register(_free, context)
    return context


def _free(context: Any) -> None:
    """At exit, while the modules that it takes are there; others may have closed the display by then."""
    with contextlib.suppress(Exception):
        context.free()
    context._context = None  # nothing is left for its finalizer, which would complain
