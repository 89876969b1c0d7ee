"""What a camera cannot see: what is out of its view, the sky over a floor, what lies under a table top."""

from typing import Any

import mujoco
import numba
import numpy as np

from playlearn.episode import Array

_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_APART = 1e-5  # meters: what is flush with a top is not beyond it


class Culling:
    """Of a model's geoms, floors (g,) bool may hide the sky, and tops (g,) bool what lies beyond them."""

    def __init__(self, model: mujoco.MjModel, floors: Array, tops: Array) -> None:
        alpha = np.where(model.geom_matid >= 0, model.mat_rgba[model.geom_matid, 3], model.geom_rgba[:, 3])
        box, plane = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX, model.geom_type == _PLANE
        self._model = model
        self._floors = np.flatnonzero(floors & (alpha == 1) & plane)
        self._tops = np.flatnonzero(tops & (alpha == 1) & box)

    def seen(self, data: mujoco.MjData, camera: int, aspect: float) -> tuple[Array, bool]:
        """(g,) bool: geoms that a camera, as it stands, may see; and whether it may see the sky.

        Not seen are those whose bounding boxes are wholly beyond a side of the view, and those wholly beyond a top
        that fills it.
        """
        model = self._model
        scene = model.geom_type, model.geom_size, data.geom_xpos, data.geom_xmat
        eye, rays = data.cam_xpos[camera], _corner_rays(model, data, camera, aspect)
        seen = _in_view(model.geom_aabb, model.geom_rbound, data.geom_xpos, data.geom_xmat, eye, rays)
        hits = np.empty((4, 3))
        if not _fills(self._tops, *scene, eye, rays, hits):
            return seen, not _fills(self._floors, *scene, eye, rays, hits)
        _leave_out_beyond(seen, model.geom_type, model.geom_aabb, data.geom_xpos, data.geom_xmat, eye, hits)
        return seen, False


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
    """Whether the upper face of one of the geoms, planes or boxes, fills the view; where the rays meet the nearest."""
    nearest, met = np.inf, np.empty((4, 3))
    for g in geoms:
        turn = xmat[g].reshape(3, 3)
        above = _dot(turn[:, 2], eye - xpos[g]) - (0.0 if kind[g] == _PLANE else size[g, 2])
        whole, far = above > 0.0, 0.0
        for k in range(4):
            down = -_dot(turn[:, 2], rays[k])
            if not whole or down <= 1e-9:
                whole = False
                break
            far = max(far, above / down)
            met[k] = eye + rays[k] * (above / down)
            for axis in range(2):
                half = size[g, axis] if kind[g] != _PLANE or size[g, axis] > 0.0 else np.inf  # a plane of 0 has no end
                whole = whole and abs(_dot(turn[:, axis], met[k] - xpos[g])) < half
        if whole and far < nearest:
            nearest, hits[:] = far, met
    return bool(nearest < np.inf)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _leave_out_beyond(seen: Any, kind: Any, aabb: Any, xpos: Any, xmat: Any, eye: Any, hits: Any) -> None:
    """Of what is seen (g,) bool, what has a side on which all of the pyramid from the eye to the hits (4, 3) is."""
    for g in np.flatnonzero(seen):
        turn = xmat[g].reshape(3, 3)
        for axis in range(3):
            low = high = _dot(turn[:, axis], eye - xpos[g])
            for k in range(4):
                at = _dot(turn[:, axis], hits[k] - xpos[g])
                low, high = min(low, at), max(high, at)
            if kind[g] == _PLANE:
                apart = axis == 2 and low > _APART
            else:
                apart = abs((low + high) / 2 - aabb[g, axis]) - (high - low) / 2 > aabb[g, 3 + axis] + _APART
            if apart:
                seen[g] = False
                break


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _in_view(aabb: Any, reach: Any, xpos: Any, xmat: Any, eye: Any, rays: Any) -> Any:
    """(g,) bool; aabb (g, 6): center and half sizes of each geom's box, in its own frame; reach (g,): 0 has no end."""
    outward = np.empty((5, 3))
    for k in range(4):
        outward[k] = np.cross(rays[k], rays[(k + 1) % 4])  # out of the side between two corners
    outward[4] = -(rays[0] + rays[1] + rays[2] + rays[3])  # backwards
    inside, middle = np.ones(len(xpos), np.bool_), np.empty(3)
    for g in np.flatnonzero(reach > 0.0):
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
