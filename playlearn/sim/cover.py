"""What a camera cannot see because one flat thing fills its view: the sky over a floor, the room under a table top."""

import mujoco
import numpy as np

from playlearn.episode import Array

_CORNERS = np.array([[x, y, -1.0] for x in (-1, 1) for y in (-1, 1)])  # a camera looks along -z


class Cover:
    """Geometry of a scene's flat things. room, tops: (g,) bool: the world's own geoms, and what stands still in it."""

    def __init__(self, model: mujoco.MjModel, room: Array, tops: Array) -> None:
        plane, box = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
        alpha = np.where(model.geom_matid >= 0, model.mat_rgba[model.geom_matid, 3], model.geom_rgba[:, 3])
        self._model, self._room = model, np.flatnonzero(room)
        self._floors = np.flatnonzero(room & (alpha == 1) & (model.geom_type == plane))
        self._tops = np.flatnonzero(tops & (alpha == 1) & (model.geom_type == box))
        self._flat = bool(np.isin(model.geom_type[self._room], (plane, box)).all())

    def seen(self, data: mujoco.MjData, camera: int, aspect: float) -> tuple[bool, bool]:
        """Whether a camera, as it stands, may see the sky, and anything of the room."""
        slope = np.tan(np.deg2rad(self._model.cam_fovy[camera]) / 2)
        eye, turn = data.cam_xpos[camera], data.cam_xmat[camera].reshape(3, 3)
        rays = _CORNERS * [slope * aspect, slope, 1.0] @ turn.T  # (4, 3)
        corners = self._filling(data, self._tops, eye, rays)
        if corners is not None and self._flat and self._room_is_outside(data, np.concatenate([eye[None], corners])):
            return False, False
        return self._filling(data, self._floors, eye, rays) is None, True

    def _filling(self, data: mujoco.MjData, geoms: Array, eye: Array, rays: Array) -> Array | None:
        """(4, 3) where the view's corners meet the upper face of the first of these geoms that fills it."""
        if not len(geoms):
            return None
        frames, size = data.geom_xmat[geoms].reshape(-1, 3, 3), self._model.geom_size[geoms]
        plane = self._model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_PLANE
        local = np.einsum("gi,gij->gj", eye - data.geom_xpos[geoms], frames)  # (g, 3)
        local[:, 2] -= np.where(plane, 0.0, size[:, 2])
        ways = np.einsum("ri,gij->grj", rays, frames)  # (g, 4, 3)
        down = np.minimum(ways[:, :, 2], -1e-9)
        far = -local[:, None, 2] / down  # (g, 4), in lengths of a ray
        hits = local[:, None, :2] + far[:, :, None] * ways[:, :, :2]
        half = np.where(plane[:, None] & (size[:, :2] == 0), np.inf, size[:, :2])  # a plane of size 0 has no end
        inside = (np.abs(hits) < half[:, None]).all(axis=(1, 2)) & (ways[:, :, 2] < 0).all(axis=1) & (local[:, 2] > 0)
        found = np.flatnonzero(inside)
        return eye + far[found[0], :, None] * rays if len(found) else None

    def _room_is_outside(self, data: mujoco.MjData, pyramid: Array) -> bool:
        """Whether each of the room's geoms has a side of its own on which all of the view (5, 3) is."""
        room, size = self._room, self._model.geom_size[self._room]
        local = np.einsum(
            "gpi,gij->gpj", pyramid - data.geom_xpos[room][:, None], data.geom_xmat[room].reshape(-1, 3, 3)
        )
        plane = self._model.geom_type[room] == mujoco.mjtGeom.mjGEOM_PLANE
        beyond = (local.min(axis=1) > size) | (local.max(axis=1) < -size)  # (g, 3)
        above = local[:, :, 2].min(axis=1) > 0
        return bool(np.where(plane, above, beyond.any(axis=1)).all())
