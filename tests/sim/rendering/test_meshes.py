"""Laws of simplifying: near to the original, from its own vertices, closed where it was, and much smaller."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from playlearn.sim.rendering.meshes import simplify


def sphere(rings: int = 40, radius: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """A closed surface: `rings` circles of 2 * rings points, and two poles."""
    sectors = 2 * rings
    polar, around = np.meshgrid(np.linspace(0, np.pi, rings + 2)[1:-1], np.arange(sectors) * 2 * np.pi / sectors)
    ring = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    vertices = np.concatenate([ring.transpose(1, 0, 2).reshape(-1, 3), [[0, 0, 1.0], [0, 0, -1.0]]])
    faces = []
    for j in range(sectors):
        k = (j + 1) % sectors
        faces.append([len(vertices) - 2, j, k])
        faces.append([len(vertices) - 1, (rings - 1) * sectors + k, (rings - 1) * sectors + j])
        for i in range(rings - 1):
            a, b, c, d = i * sectors + j, i * sectors + k, (i + 1) * sectors + j, (i + 1) * sectors + k
            faces += [[a, c, b], [b, c, d]]
    return radius * vertices, np.array(faces)


def sheet(cells: int = 20, side: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """A flat open square of cells x cells quads."""
    x, y = np.meshgrid(np.linspace(0, side, cells + 1), np.linspace(0, side, cells + 1), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.stack([corner, corner + cells + 1, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + cells + 1, corner + cells + 2], axis=1)
    return vertices, np.concatenate([lower, upper])


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def points_on(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Some 66 points on each triangle."""
    weights = np.array([[i, j, 10 - i - j] for i in range(11) for j in range(11 - i)]) / 10
    return (weights @ vertices[faces]).reshape(-1, 3)


@pytest.mark.parametrize("tolerance", [0.0005, 0.002, 0.008])
def test_no_point_of_the_surface_is_far_from_what_is_left(tolerance: float) -> None:
    """Twice the tolerance is allowed: the error that is held to it is a mean over the planes that met in a point."""
    vertices, faces = sphere()
    fewer, _ = simplify(vertices, faces, tolerance)
    assert len(fewer) < 0.5 * len(faces)
    spacing = 0.002  # what the sampling itself may add, on triangles of up to 2 cm
    far, _ = cKDTree(points_on(vertices, fewer)).query(vertices)
    assert far.max() < 2 * tolerance + spacing
    radius = np.linalg.norm(points_on(vertices, fewer), axis=1)
    assert radius.min() > 0.1 - 2 * tolerance


def test_a_coarser_tolerance_leaves_less() -> None:
    vertices, faces = sphere()
    left = [len(simplify(vertices, faces, tolerance)[0]) for tolerance in (0.0003, 0.001, 0.003, 0.01)]
    assert left == sorted(left, reverse=True)
    assert left[0] > 3 * left[-1]


def test_a_closed_surface_stays_closed_and_outward() -> None:
    vertices, faces = sphere()
    fewer, _ = simplify(vertices, faces, 0.004)
    edges = np.concatenate([fewer[:, [0, 1]], fewer[:, [1, 2]], fewer[:, [2, 0]]])
    there, back = {tuple(edge) for edge in edges.tolist()}, {tuple(edge[::-1]) for edge in edges.tolist()}
    assert len(there) == len(edges)  # each once in each direction
    assert there == back
    a, b, c = (vertices[fewer[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).all()


def test_a_flat_sheet_keeps_its_outline_and_little_else() -> None:
    """Two triangles would do; the corners cannot go, as the border's own walls hold them."""
    vertices, faces = sheet()
    fewer, _ = simplify(vertices, faces, 0.001)
    assert len(fewer) < 12
    assert area(vertices, fewer) == pytest.approx(0.04, rel=1e-6)


def test_what_is_left_stands_on_vertices_that_were_there() -> None:
    vertices, faces = sphere(12)
    split = vertices[faces].reshape(-1, 3)  # as a file has it that gives each triangle its own corners
    fewer, stands_for = simplify(split, np.arange(len(split)).reshape(-1, 3), 0.004)
    assert 4 < len(fewer) < 0.7 * len(faces)  # it saw that they are the same points
    np.testing.assert_allclose(split[stands_for], split, atol=1e-9)
    assert set(fewer.ravel()) <= set(stands_for)


def test_specks_vanish() -> None:
    vertices, faces = sphere(6, radius=0.001)
    fewer, _ = simplify(vertices, faces, 0.01)
    assert fewer.shape == (0, 3)
