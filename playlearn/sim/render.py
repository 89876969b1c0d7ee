"""Small images of a scene, quickly: simplified visual meshes, no multisampling, one GL context a process."""

import atexit
import functools
import importlib
import os
from collections.abc import Callable
from typing import Any

import fast_simplification
import mujoco
import numpy as np

from playlearn.episode import Array
from playlearn.errors import RenderError

VISUAL_GROUP = 1


class Renderer:
    """Draws a model in any state, from any camera, in any size; holds its own data, never the simulation's.

    xml: the scene. faces: visual meshes are simplified to about this many triangles in all.
    paint: called with the model before drawing, to show what is not in qpos (a lit lamp).

    Raises:
        RenderError: no headless OpenGL can be had; the message says what to install.
    """

    def __init__(self, xml: str, faces: int, paint: Callable[[mujoco.MjModel, Array], None]) -> None:
        self._model = _simplified(xml, faces).compile()
        self._model.vis.quality.offsamples = 0
        self._model.vis.quality.shadowsize = 1024
        self._model.vis.headlight.diffuse[:] = 0.25  # robosuite's lights and a full headlight bleach a white table
        self._data = mujoco.MjData(self._model)
        self._paint = paint
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[VISUAL_GROUP] = 1
        self._option.sitegroup[:] = 0
        self._scene = mujoco.MjvScene(self._model, maxgeom=2000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._context: mujoco.MjrContext | None = None
        self._size = (0, 0)
        self._state: Array | None = None

    def set_state(self, qpos: Array, extra: Array) -> None:
        """Place everything: qpos (nq,), and what `paint` shows."""
        self._paint(self._model, extra)
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def draw(self, camera: str, height: int, width: int) -> Array:
        """(h, w, 3) uint8, upright, of the state last set."""
        context = self._need(height, width)
        view = mujoco.MjvCamera()
        view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        view.fixedcamid = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        rectangle = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rectangle, self._scene, context)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(image, None, rectangle, context)
        return np.ascontiguousarray(image[::-1])  # OpenGL's rows go bottom-up

    def backend(self) -> str:
        """GL back end and device, such as `egl: llvmpipe (LLVM 15.0.6, 256 bits)`."""
        self._need(1, 1)
        from OpenGL import GL  # only once a platform has been chosen by the context

        return f"{os.environ.get('MUJOCO_GL', 'default')}: {GL.glGetString(GL.GL_RENDERER).decode()}"

    def _need(self, height: int, width: int) -> mujoco.MjrContext:
        gl = _gl_context(1024, 1024)
        gl.make_current()  # somebody else in this process may have drawn meanwhile
        if self._context is None or height > self._size[0] or width > self._size[1]:
            self._size = (max(height, self._size[0], 128), max(width, self._size[1], 128))
            self._model.vis.global_.offheight, self._model.vis.global_.offwidth = self._size
            if self._context is not None:
                self._context.free()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        return self._context


@functools.cache
def _gl_context(width: int, height: int) -> Any:
    platform = os.environ.setdefault("MUJOCO_GL", "egl").lower()
    try:
        # Not `mujoco.gl_context`, which chose when mujoco was first imported, perhaps before we could say egl.
        name = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa"}.get(platform, "mujoco.gl_context")
        context = importlib.import_module(name).GLContext(width, height)
        context.make_current()
        atexit.register(context.free)  # while the modules that it needs to be freed are still there
    except Exception as error:
        raise RenderError(
            f"no headless OpenGL ({error}): install it with `apt-get install libegl1 libgl1-mesa-dri`, "
            "or collect without images and render where there is one; `playlearn doctor` checks"
        ) from error
    return context


def _simplified(xml: str, faces: int) -> mujoco.MjSpec:
    """The scene with the triangles of every mesh that is only looked at replaced by about `faces` in all."""
    spec = mujoco.MjSpec.from_string(xml)
    full = mujoco.MjModel.from_xml_string(xml)
    touched = {geom.meshname for geom in spec.geoms if geom.meshname and (geom.contype or geom.conaffinity)}
    counts = {mesh.name: int(full.mesh(mesh.name).facenum[0]) for mesh in spec.meshes}
    drawn = {geom.meshname for geom in spec.geoms if geom.meshname and geom.group == VISUAL_GROUP} - touched
    total = sum(counts[name] for name in drawn)
    for mesh in spec.meshes:
        if mesh.name not in drawn or total <= faces:
            continue
        share = max(60, int(faces * counts[mesh.name] / total))
        if share >= counts[mesh.name]:
            continue
        ident = full.mesh(mesh.name).id
        v0, vn = full.mesh_vertadr[ident], full.mesh_vertnum[ident]
        f0, fn = full.mesh_faceadr[ident], full.mesh_facenum[ident]
        # Files split vertices at seams; welded, a surface can be thinned without tearing it.
        welded, inverse = np.unique(full.mesh_vert[v0 : v0 + vn].round(6), axis=0, return_inverse=True)
        vertices, triangles = fast_simplification.simplify(
            welded.astype(np.float32), inverse.ravel()[full.mesh_face[f0 : f0 + fn]], target_count=share
        )
        # The compiled vertices stand in the mesh's own inertial frame: put them back where the file had them.
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, full.mesh_quat[ident])
        vertices = vertices @ rotation.reshape(3, 3).T + full.mesh_pos[ident]
        mesh.file = ""
        mesh.scale = [1, 1, 1]
        mesh.refpos, mesh.refquat = [0, 0, 0], [1, 0, 0, 0]
        mesh.uservert = vertices.astype(np.float32).ravel()
        mesh.userface = triangles.astype(np.int32).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return spec
