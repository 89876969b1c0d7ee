"""What a camera cannot see: what is out of its view, the sky over a floor, the room under a table top."""

from typing import Any

import mujoco
import numba
import numpy as np

from playlearn.episode import Array

_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)


class Cover:
    """The room (g,) bool, geoms fixed to the world itself, and what stands still in it and may hide it (g,) bool."""

    def __init__(self, model: mujoco.MjModel, room: Array, tops: Array) -> None:
        alpha = np.where(model.geom_matid >= 0, model.mat_rgba[model.geom_matid, 3], model.geom_rgba[:, 3])
        box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._model, self._room = model, np.flatnonzero(room)
        self._floors = np.flatnonzero(room & (alpha == 1) & plane)
        self._tops = np.flatnonzero(tops & (alpha == 1) & box)
        self._flat = bool((box | plane)[self._room].all())

    def seen(self, data: mujoco.MjData, camera: int, aspect: float) -> tuple[bool, bool]:
        """Whether a camera, as it stands, may see the sky, and anything of the room."""
        model = self._model
        scene = model.geom_type, model.geom_size, data.geom_xpos, data.geom_xmat
        eye, rays = data.cam_xpos[camera], _corner_rays(model, data, camera, aspect)
        if self._flat and _hidden_by_a_top(self._tops, self._room, *scene, eye, rays):
            return False, False
        return not _fills(self._floors, *scene, eye, rays, np.empty((4, 3))), True

    def in_view(self, data: mujoco.MjData, camera: int, aspect: float) -> Array:
        """(g,) bool: geoms whose bounding boxes are not wholly beyond a side of the view; MuJoCo itself draws all."""
        eye, rays = data.cam_xpos[camera], _corner_rays(self._model, data, camera, aspect)
        inside: Array = _in_view(self._model.geom_aabb, data.geom_xpos, data.geom_xmat, eye, rays)
        inside |= self._model.geom_rbound == 0  # a plane has no end
        return inside


def _corner_rays(model: mujoco.MjModel, data: mujoco.MjData, camera: int, aspect: float) -> Array:
    """(4, 3) ways from the eye through the image's corners, going round it, one unit deep."""
    up = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    across = up * aspect
    corners = np.array([[across, up, -1.0], [-across, up, -1.0], [-across, -up, -1.0], [across, -up, -1.0]])
    rays: Array = corners @ data.cam_xmat[camera].reshape(3, 3).T
    return rays


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _fills(geoms: Any, kind: Any, size: Any, xpos: Any, xmat: Any, eye: Any, rays: Any, hits: Any) -> bool:
    """Whether the upper face of one of the geoms, planes or boxes, fills the view; where the rays meet it (4, 3)."""
    for g in geoms:
        turn = xmat[g].reshape(3, 3)
        above = _dot(turn[:, 2], eye - xpos[g]) - (0.0 if kind[g] == _PLANE else size[g, 2])
        whole = above > 0.0
        for k in range(4):
            down = -_dot(turn[:, 2], rays[k])
            if not whole or down <= 1e-9:
                whole = False
                break
            hits[k] = eye + rays[k] * (above / down)
            for axis in range(2):
                half = size[g, axis] if kind[g] != _PLANE or size[g, axis] > 0.0 else np.inf  # a plane of 0 has no end
                whole = whole and abs(_dot(turn[:, axis], hits[k] - xpos[g])) < half
        if whole:
            return True
    return False


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _hidden_by_a_top(tops: Any, room: Any, kind: Any, size: Any, xpos: Any, xmat: Any, eye: Any, rays: Any) -> bool:
    """Whether a top fills the view, and each of the room's geoms has a side on which all of the view before it is."""
    hits = np.empty((4, 3))
    if not _fills(tops, kind, size, xpos, xmat, eye, rays, hits):
        return False
    for g in room:
        turn, apart = xmat[g].reshape(3, 3), False
        for axis in range(3):
            low = high = _dot(turn[:, axis], eye - xpos[g])
            for k in range(4):
                at = _dot(turn[:, axis], hits[k] - xpos[g])
                low, high = min(low, at), max(high, at)
            if kind[g] == _PLANE:
                apart = apart or (axis == 2 and low > 0.0)
            else:
                apart = apart or low > size[g, axis] or high < -size[g, axis]
        if not apart:
            return False
    return True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _in_view(aabb: Any, xpos: Any, xmat: Any, eye: Any, rays: Any) -> Any:
    """(g,) bool; aabb (g, 6): centre and half sizes of each geom's box, in its own frame."""
    outward = np.empty((5, 3))
    for k in range(4):
        outward[k] = np.cross(rays[k], rays[(k + 1) % 4])  # out of the side between two corners
    outward[4] = -(rays[0] + rays[1] + rays[2] + rays[3])  # backwards
    inside, middle = np.ones(len(xpos), np.bool_), np.empty(3)
    for g in range(len(xpos)):
        turn = xmat[g].reshape(3, 3)
        for axis in range(3):
            middle[axis] = xpos[g, axis] + _dot(turn[axis], aabb[g, :3]) - eye[axis]
        for side in range(5):
            thick = 0.0
            for axis in range(3):
                thick += abs(_dot(outward[side], turn[:, axis])) * aabb[g, 3 + axis]
            if _dot(outward[side], middle) > thick:
                inside[g] = False
                break
    return inside
