"""Triangulation: within the tolerance, no finer than needed, and heights between corners."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.terrain.nurbs import NurbsSurface
from echelon.terrain.triangulation import TriangleMesh, barycentric_weights, mesh_of_lines, smooth_height, triangulate


def hilly(size: int = 25, spacing: float = 8.0) -> NurbsSurface:
    """A height field of hills 120 m from one another."""
    t = spacing * np.arange(size)
    x, y = np.meshgrid(t, t, indexing="ij")
    z = 4.0 * np.sin(x / 19.0) * np.cos(y / 23.0) + 0.02 * x
    return NurbsSurface.through(np.stack([x, y, z], axis=-1), t, t)


def bend() -> NurbsSurface:
    """A road round a right angle: 30 m straight, an arc of 10 m, 30 m straight; rising and rolling."""
    s = np.concatenate(
        [np.arange(0.0, 30.0, 2.0), 30.0 + np.linspace(0.0, 5 * np.pi, 17), 46.0 + np.arange(1.5, 30.0, 2)]
    )
    turn = np.clip((s - 30.0) / 10.0, 0.0, np.pi / 2)
    before, after = np.minimum(s - 30.0, 0.0), np.maximum(s - 30.0 - 5 * np.pi, 0.0)
    center = np.stack([10 * np.sin(turn) + before, 10 - 10 * np.cos(turn) + after], axis=1)
    left = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    offset = np.linspace(-5.0, 5.0, 6)
    flat = center[None] + offset[:, None, None] * left[None]
    z = np.broadcast_to(0.05 * s + 0.2 * np.sin(s / 6.0), (6, len(s)))
    # u goes to the left, v along: u x v would point down, so u goes to the right.
    return NurbsSurface.through(np.concatenate([flat, z[..., None]], axis=-1)[::-1], offset, s)


def within(mesh: TriangleMesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random places in triangles: (barycentric weights, triangles, places)."""
    random = np.random.default_rng(seed)
    triangle = random.integers(0, len(mesh.triangles), count)
    weights = random.dirichlet((1.0, 1.0, 1.0), count)
    return weights, triangle, np.einsum("nk,nkx->nx", weights, mesh.points[mesh.triangles[triangle]])


def surface_heights(
    surface: NurbsSurface, mesh: TriangleMesh, weights: np.ndarray, triangle: np.ndarray, places: np.ndarray
):
    guess = np.einsum("nk,nkx->nx", weights, mesh.uv[mesh.triangles[triangle]])
    u, v = surface.parameters_at(places[:, :2], guess[:, 0], guess[:, 1])
    found = surface.point(u, v)
    reached = np.linalg.norm(found[:, :2] - places[:, :2], axis=1) < 1e-6  # the chord of an outer edge may lie outside
    assert reached.mean() > 0.98
    return found[:, 2], reached


@pytest.mark.parametrize("make", [hilly, bend])
@pytest.mark.parametrize("tolerance", [0.2, 0.02])
def test_flat_triangles_are_within_the_tolerance(make, tolerance: float):
    surface = make()
    mesh = triangulate(surface, tolerance)
    weights, triangle, places = within(mesh, 4000, 1)
    heights, reached = surface_heights(surface, mesh, weights, triangle, places)
    assert np.abs(heights - places[:, 2])[reached].max() < tolerance


@pytest.mark.parametrize("make", [hilly, bend])
@pytest.mark.parametrize("tolerance", [0.01, 0.001])
def test_smooth_triangles_are_within_the_tolerance(make, tolerance: float):
    surface = make()
    mesh = triangulate(surface, tolerance, smooth=True)
    weights, triangle, places = within(mesh, 4000, 2)
    heights, reached = surface_heights(surface, mesh, weights, triangle, places)
    assert mesh.bulges is not None
    corners = mesh.triangles[triangle]
    found, _ = smooth_height(mesh.points[corners], mesh.gradients[corners], weights, mesh.bulges[triangle])
    assert np.abs(heights - found)[reached].max() < tolerance


def test_smooth_triangles_need_far_fewer():
    surface = hilly()
    lines = np.array([0.0, 192.0])
    flat = triangulate(surface, 0.002, u=lines, v=lines)
    smooth = triangulate(surface, 0.002, smooth=True, u=lines, v=lines)
    assert len(smooth.triangles) < len(flat.triangles) / 20


def test_a_plane_needs_two_triangles():
    t = np.linspace(0.0, 10.0, 5)
    x, y = np.meshgrid(t, t, indexing="ij")
    plane = NurbsSurface.through(np.stack([x, y, 0.3 * x - 0.2 * y], axis=-1), t, t)
    mesh = triangulate(plane, 1e-6, u=t[[0, -1]], v=t[[0, -1]])
    assert len(mesh.triangles) == 2
    np.testing.assert_allclose(mesh.gradients, [[0.3, -0.2]] * 4, atol=1e-12)
    with pytest.raises(ValueError, match="tolerance"):
        triangulate(plane, 0.0)


def test_triangles_face_up_and_cover_without_cracks():
    for surface in (hilly(), bend()):
        mesh = triangulate(surface, 0.05)
        a, b, c = (mesh.points[mesh.triangles[:, k], :2] for k in range(3))
        twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert twice.min() > 0.0
        assert mesh.normals[:, 2].min() > 0.5
        edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, counts = np.unique(edges, axis=0, return_counts=True)
        assert set(counts.tolist()) == {1, 2}
        # Only the rim belongs to one triangle: as many edges as the grid has around it.
        columns = len(np.unique(mesh.uv[:, 1]))
        rows = len(np.unique(mesh.uv[:, 0]))
        assert np.sum(counts == 1) == 2 * (rows - 1 + columns - 1)


def test_quadratic_heights_are_exact():
    random = np.random.default_rng(6)
    flat = random.normal(size=(50, 3, 2))
    a, b, c = random.normal(size=3)

    def height(p: np.ndarray) -> np.ndarray:
        return a * p[..., 0] ** 2 + b * p[..., 0] * p[..., 1] + c * p[..., 1] ** 2 + p[..., 0]

    def gradient(p: np.ndarray) -> np.ndarray:
        return np.stack([2 * a * p[..., 0] + b * p[..., 1] + 1.0, b * p[..., 0] + 2 * c * p[..., 1]], axis=-1)

    weights = random.dirichlet((1.0, 1.0, 1.0), 50)
    places = np.einsum("nk,nkx->nx", weights, flat)
    corners = np.concatenate([flat, height(flat)[..., None]], axis=-1)
    z, slope = smooth_height(corners, gradient(flat), weights)
    np.testing.assert_allclose(barycentric_weights(flat, places), weights, atol=1e-9)
    np.testing.assert_allclose(z, height(places), atol=1e-12)
    np.testing.assert_allclose(slope, gradient(places), atol=1e-12)


def test_neighbours_agree_along_their_edge():
    mesh = mesh_of_lines(hilly(), np.linspace(0.0, 192.0, 9), np.linspace(0.0, 192.0, 9))
    a, b, c, d = 0, 9, 10, 1  # two triangles a b c and a c d over the diagonal a c
    t = np.linspace(0.0, 1.0, 11)
    zero = np.zeros_like(t)
    first, second = np.array([a, b, c]), np.array([a, c, d])

    def along_edge(triangle: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        corners = np.broadcast_to(triangle, weights.shape)
        return smooth_height(mesh.points[corners], mesh.gradients[corners], weights, np.full(len(t), 0.1))

    one, slope_one = along_edge(first, np.stack([1 - t, zero, t], axis=1))
    two, slope_two = along_edge(second, np.stack([1 - t, t, zero], axis=1))
    np.testing.assert_allclose(one, two, atol=1e-12)
    np.testing.assert_allclose(slope_one, slope_two, atol=1e-12)
