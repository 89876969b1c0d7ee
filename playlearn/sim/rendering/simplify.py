"""A scene as it need be drawn: its visual meshes as fine as an image of some height can show them, and no finer."""

from typing import Any

import mujoco
import numpy as np

from playlearn.episode import Array
from playlearn.sim.rendering.meshes import simplify

VISUAL_GROUP = 1
FINEST = 512  # rows; images with more are drawn from the meshes as they are
_PIXELS = 0.35  # a surface may be off by so much of a pixel
_SAME_SIDE = 0.5  # cosine between the normals of two faces beyond which there is an edge to be seen between them
_NEARBY = 0.3  # meters from which a moving camera may come to see what it does not see at home


def simplified_model(spec: mujoco.MjSpec, home: Array, rows: int) -> mujoco.MjModel:
    """The scene, which is changed, compiled for images of up to `rows` rows; home (nq,) is a pose typical of cameras.

    Meshes of one body that look alike become one geom under the name of the first.
    """
    model = spec.compile()
    if rows <= FINEST:
        tolerances = _tolerances(model, home, rows)
        written = spec.geoms  # in the order of their ids
        for geoms in _alike(model, list(tolerances)):
            _join(spec, [written[geom] for geom in geoms], [_thin(model, geom, tolerances[geom]) for geom in geoms])
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6  # what is left need not weigh anything
        model = spec.compile()
        model.vis.quality.numslices, model.vis.quality.numstacks = 16, 8
    model.vis.quality.offsamples = 0
    model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, 4 * rows)
    return model


def _tolerances(model: mujoco.MjModel, home: Array, rows: int) -> dict[int, float]:
    """Geom -> meters that its surface may be off, for each mesh that is seen and has no texture laid on it."""
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    tolerances = {}
    meshes = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_group == VISUAL_GROUP)
    for geom in map(int, np.flatnonzero(meshes)):
        material = model.geom_matid[geom]
        if not (model.mesh_texcoordnum[model.geom_dataid[geom]] and (model.mat_texid[material] >= 0).any()):
            pixel = min(_pixel(model, data, geom, camera, rows) for camera in range(model.ncam))
            tolerances[geom] = _PIXELS * pixel
    return tolerances


def _pixel(model: mujoco.MjModel, data: mujoco.MjData, geom: int, camera: int, rows: int) -> float:
    """Meters that a pixel of a camera's image spans where the geom is nearest to it."""
    points = _vertices(model, model.geom_dataid[geom]) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    seen = (points - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)  # the camera looks along -z
    slope = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    inside = (np.abs(seen[:, :2]) < -slope * seen[:, 2:]).all(axis=1)
    bodies = model.geom_bodyid[geom], model.cam_bodyid[camera]
    if inside.any():
        distance = -seen[inside, 2].max()
    elif model.body_weldid[bodies[0]] == model.body_weldid[bodies[1]]:
        return np.inf  # they move together: it never will be seen
    else:
        distance = max(np.linalg.norm(seen, axis=1).min(), _NEARBY)
    return float(2 * slope * distance / rows)


def _vertices(model: mujoco.MjModel, mesh: int) -> Array:
    start = model.mesh_vertadr[mesh]
    vertices: Array = model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(np.float64)
    return vertices


def _alike(model: mujoco.MjModel, geoms: list[int]) -> list[list[int]]:
    """The geoms in groups that move together and have the same color and gloss."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for geom in geoms:
        material = model.geom_matid[geom]
        look: tuple[Any, ...] = (model.geom_rgba[geom].tobytes(),)
        if material >= 0:
            looks = (model.mat_rgba, model.mat_emission, model.mat_specular, model.mat_shininess, model.mat_texid)
            look = tuple(values[material].tobytes() for values in looks)
        groups.setdefault((int(model.geom_bodyid[geom]), *look), []).append(geom)
    return list(groups.values())


def _thin(model: mujoco.MjModel, geom: int, tolerance: float) -> tuple[Array, Array]:
    """Corners (k, 3, 3) and normals (k, 3, 3) of fewer triangles, in the frame of the geom's body."""
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    first, total = model.mesh_normaladr[mesh], model.mesh_normalnum[mesh]
    vertices, faces = _vertices(model, mesh), model.mesh_face[start : start + count].astype(np.int64)
    normals = model.mesh_normal[first : first + total][model.mesh_facenormal[start : start + count].ravel()]
    weights = np.repeat(np.linalg.norm(_flat(vertices[faces]), axis=1), 3)  # a sliver says little
    fewer, stands_for = simplify(vertices, faces, tolerance)
    shading = _shading(vertices[fewer], fewer, stands_for[faces].ravel(), normals * weights[:, None])
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    turn = rotation.reshape(3, 3).T
    return vertices[fewer] @ turn + model.geom_pos[geom], shading.reshape(-1, 3, 3) @ turn


def _join(spec: mujoco.MjSpec, old: list[mujoco.MjsGeom], parts: list[tuple[Array, Array]]) -> None:
    """Put one geom in the place of these, made of their triangles."""
    body, name, material, rgba = old[0].parent, old[0].name, old[0].material, old[0].rgba.copy()
    for geom in old:
        spec.delete(geom)
    corners, normals = (np.concatenate(values) for values in zip(*parts, strict=True))
    if len(corners) < 4:  # MuJoCo knows no such mesh
        return
    # A vertex for each normal: MuJoCo 3.9 reads a mesh's `userfacenormal` wrongly.
    vertices = np.concatenate([corners.reshape(-1, 3), normals.reshape(-1, 3)], axis=1).astype(np.float32)
    vertices, faces = np.unique(vertices, axis=0, return_inverse=True)
    spec.add_mesh(
        name=f"lean {name}",
        uservert=vertices[:, :3].ravel(),
        usernormal=vertices[:, 3:].ravel(),
        userface=faces.astype(np.int32).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"lean {name}",
        material=material,
        rgba=rgba,
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
    )


def _shading(corners: Array, faces: Array, at: Array, normals: Array) -> Array:
    """(3 k, 3) normals for the corners (k, 3, 3) of faces (k, 3): means of the original's on that side of an edge.

    normals: (c, 3), of any length, of the original's corners, which stand at the vertices `at` (c,).
    """
    flat = _flat(corners)
    flat = np.repeat(flat / np.linalg.norm(flat, axis=1, keepdims=True), 3, axis=0)  # (3 k, 3)
    order = np.argsort(at, kind="stable")
    low, high = (np.searchsorted(at[order], faces.ravel(), side) for side in ("left", "right"))
    corner = np.repeat(np.arange(faces.size), high - low)
    begins = np.cumsum(high - low) - (high - low)
    met = normals[order[np.arange(len(corner)) - begins[corner] + low[corner]]]
    met = met * ((met * flat[corner]).sum(axis=1) > _SAME_SIDE * np.linalg.norm(met, axis=1))[:, None]
    mean = np.stack([np.bincount(corner, met[:, axis], faces.size) for axis in range(3)], axis=1)
    size = np.linalg.norm(mean, axis=1, keepdims=True)
    shading: Array = np.where(size > 0, mean / np.maximum(size, 1e-300), flat)
    return shading


def _flat(corners: Array) -> Array:
    """(k, 3) normals of triangles (k, 3, 3), twice as long as they are large."""
    normals: Array = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals
