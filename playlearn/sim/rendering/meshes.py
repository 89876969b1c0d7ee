"""Surfaces with fewer triangles, none farther from the original than a small image can show.

Points are merged into neighbors, cheapest first, while the quadric error (Garland and Heckbert, 1997) of the
merged point, as a distance, stays within a tolerance. A point only ever moves onto another one, so that what is
left keeps its place and its normal; an open border only shrinks along itself.
"""

from typing import Any

import numba
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from playlearn.episode import Array

_BORDER_WEIGHT = 10.0
_STEEPEST = 0.25  # cosine between a triangle's normals before and after a merger
_WORTHWHILE = 0.99  # another round as long as the last one left so much or less


def simplify(vertices: Array, faces: Array, tolerance: float) -> tuple[Array, Array]:
    """Fewer faces (k, 3) over some of the same vertices (n, 3), within about `tolerance` of the faces (m, 3).

    Vertices that stand within a hundredth of the tolerance of each other count as one; the second array (n,) says
    which stands for each. Pieces that are smaller than the tolerance vanish, and there may be nothing left.
    """
    cells = np.round(vertices / (tolerance / 100)).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    _, first, point = np.unique(
        (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2], return_index=True, return_inverse=True
    )
    points = np.ascontiguousarray(vertices[first], np.float64)
    kept = _whole(point.astype(np.int64)[faces])
    quadrics = _quadrics(points, kept)
    before = np.inf
    while len(kept) < _WORTHWHILE * before:
        before = len(kept)
        kept = _whole(_merge(points, kept, quadrics, tolerance**2)[kept])
    return first[_without_specks(points, kept, tolerance)], first[point]


def _whole(faces: Array) -> Array:
    """Without the faces that have collapsed to a line."""
    a, b, c = faces.T
    whole: Array = faces[(a != b) & (b != c) & (c != a)]
    return whole


def _without_specks(points: Array, faces: Array, size: float) -> Array:
    """Without connected pieces whose box is smaller than `size` in every direction."""
    ends = faces[:, [0, 0]].ravel(), faces[:, [1, 2]].ravel()
    count, piece = connected_components(coo_array((np.ones(len(ends[0])), ends), [len(points)] * 2), directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece[faces].ravel(), points[faces.ravel()])
    np.maximum.at(high, piece[faces].ravel(), points[faces.ravel()])
    large: Array = faces[(high - low).max(axis=1)[piece[faces[:, 0]]] >= size]
    return large


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _faces_around(faces: Any, size: int) -> Any:
    """start (n + 1,) and around (3 m,): the faces at point i are around[start[i]:start[i + 1]]."""
    count, around = np.zeros(size + 1, np.int64), np.empty(faces.size, np.int64)
    for point in faces.ravel():
        count[point + 1] += 1
    start = np.cumsum(count)
    free = start.copy()
    for f in range(len(faces)):
        for point in faces[f]:
            around[free[point]] = f
            free[point] += 1
    return start, around


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _open_edges(faces: Any, start: Any, around: Any) -> Any:
    """(m, 3): whether no face runs along edge k of a face, from corner k to the next, in the other direction."""
    open_edge = np.ones(faces.shape, np.bool_)
    for f in range(len(faces)):
        for k in range(3):
            begin, end = faces[f, k], faces[f, (k + 1) % 3]
            for other in around[start[end] : start[end + 1]]:
                for j in range(3):
                    if faces[other, j] == end and faces[other, (j + 1) % 3] == begin:
                        open_edge[f, k] = False
    return open_edge


def _quadrics(points: Array, faces: Array) -> Array:
    """(n, 11): for each point, what `_squared_distance` reads, of its faces' planes and of walls on open edges."""
    corners = points[faces]  # (m, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    planes = _planes(normal, corners[:, 0], np.sqrt(area))
    quadrics = np.zeros((len(points), 11))
    for corner in np.ascontiguousarray(faces.T):
        _add(quadrics, corner, planes)
    face, edge = np.nonzero(_open_edges(faces, *_faces_around(faces, len(points))))
    begin, end = faces[face, edge], faces[face, (edge + 1) % 3]
    along = points[end] - points[begin]
    length = np.linalg.norm(along, axis=1)
    wall = np.cross(along / np.maximum(length, 1e-300)[:, None], normal[face])
    walls = _planes(wall, points[begin], _BORDER_WEIGHT * length)
    _add(quadrics, begin, walls)
    _add(quadrics, end, walls)
    return quadrics


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add(rows: Any, at: Any, values: Any) -> None:
    """rows[at[i]] += values[i], where an index may come twice."""
    for i in range(len(at)):
        for k in range(values.shape[1]):
            rows[at[i], k] += values[i, k]


def _planes(normal: Array, through: Array, weight: Array) -> Array:
    """(m, 11): xx xy xz yy yz zz | x y z | 1 of a plane's squared distance, and 1, all times its weight."""
    x, y, z = normal.T
    d = -(normal * through).sum(axis=1)
    return (
        np.stack([x * x, x * y, x * z, y * y, y * z, z * z, x * d, y * d, z * d, d * d, d * 0 + 1], 1) * weight[:, None]
    )


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _squared_distance(q: Any, point: Any) -> Any:
    """The mean squared distance of a point (3,) to the planes of a quadric (11,)."""
    x, y, z = point
    value = q[0] * x * x + q[3] * y * y + q[5] * z * z + q[9]
    value = value + 2 * (q[1] * x * y + q[2] * x * z + q[4] * y * z + q[6] * x + q[7] * y + q[8] * z)
    return abs(value) / max(q[10], 1e-300)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _mergers(points: Any, faces: Any, open_edge: Any, quadrics: Any, limit: float) -> Any:
    """source, target and cost (k,) of every merger along an edge that is allowed and costs no more than `limit`."""
    leaving, coming = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            if open_edge[f, k]:
                leaving[faces[f, k]] += 1
                coming[faces[f, (k + 1) % 3]] += 1
    source, target = np.empty(2 * faces.size, np.int64), np.empty(2 * faces.size, np.int64)
    cost, count = np.empty(2 * faces.size), 0
    for back in (False, True):
        for f in range(len(faces)):
            for k in range(3):
                i, j = faces[f, k], faces[f, (k + 1) % 3]
                if back:
                    i, j = j, i
                on_border = open_edge[f, k] and leaving[i] == 1 and coming[i] == 1
                if on_border or (leaving[i] == 0 and coming[i] == 0):
                    price = _squared_distance(quadrics[i], points[j])
                    if price <= limit:
                        source[count], target[count], cost[count] = i, j, price
                        count += 1
    return source[:count], target[:count], cost[:count]


def _merge(points: Array, faces: Array, quadrics: Array, limit: float) -> Array:
    """One round of mergers that do not touch each other: point -> point (n,)."""
    remap = np.arange(len(points))
    start, around = _faces_around(faces, len(points))
    open_edge = _open_edges(faces, start, around)
    source, target, cost = _mergers(points, faces, open_edge, quadrics, limit)
    if not len(cost):
        return remap
    # The cheapest first, and the others again once these are done: their neighborhood will have changed.
    third = len(cost) // 3
    cheap = np.flatnonzero(cost <= 1.5 * np.partition(cost, third)[third])
    order = cheap[np.argsort(cost[cheap], kind="stable")]
    _merge_in_order(points, faces, start, around, source[order], target[order], remap)
    moved = np.flatnonzero(remap != np.arange(len(points)))
    quadrics[remap[moved]] += quadrics[moved]  # no two onto the same point
    return remap


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _merge_in_order(points: Any, faces: Any, start: Any, around: Any, source: Any, target: Any, remap: Any) -> None:
    """Fill `remap`; see `_faces_around`."""
    touched = np.zeros(len(points), np.bool_)
    for n in range(len(source)):
        i, j = source[n], target[n]
        if touched[i] or touched[j] or _flips(points, faces, around[start[i] : start[i + 1]], remap, i, j):
            continue
        remap[i] = j
        touched[i] = touched[j] = True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _flips(points: Any, faces: Any, around: Any, remap: Any, i: int, j: int) -> bool:
    """Whether moving point i onto j would turn one of the faces at i over."""
    for f in around:
        a, b, c = remap[faces[f, 0]], remap[faces[f, 1]], remap[faces[f, 2]]
        if j in (a, b, c) or a == b or b == c or c == a:
            continue  # it vanishes
        while a != i:
            a, b, c = b, c, a
        x, y, z = points[b, 0] - points[i, 0], points[b, 1] - points[i, 1], points[b, 2] - points[i, 2]
        ex, ey, ez = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1], points[c, 2] - points[b, 2]
        nx, ny, nz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex  # the normal before
        x, y, z = points[b, 0] - points[j, 0], points[b, 1] - points[j, 1], points[b, 2] - points[j, 2]
        mx, my, mz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex  # and after
        sizes = (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
        if nx * mx + ny * my + nz * mz <= _STEEPEST * np.sqrt(sizes):
            return True
    return False
