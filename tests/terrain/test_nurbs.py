"""NURBS surfaces: the exact circle, the basis, derivatives against differences, surfaces through points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import BSpline

from echelon.terrain.nurbs import NurbsSurface, basis

CIRCLE_KNOTS = np.array([0, 0, 0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1, 1, 1])


def cylinder(radius: float = 2.0, height: float = 3.0) -> NurbsSurface:
    """Nine points of weights 1 and sqrt(1/2) make a circle, by degree two; swept up by degree one."""
    square = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]]) * radius
    rings = [np.c_[square, np.full(9, z)] for z in (0.0, height)]
    weights = np.array([1.0, math.sqrt(0.5)] * 4 + [1.0])
    return NurbsSurface(
        np.stack(rings, axis=1), CIRCLE_KNOTS, np.array([0.0, 0, 1, 1]), 2, 1, np.stack([weights, weights], axis=1)
    )


def wavy(closed: bool = False) -> tuple[NurbsSurface, np.ndarray, np.ndarray, np.ndarray]:
    """A surface through a grid of points, with the grid."""
    random = np.random.default_rng(2)
    u = np.linspace(0.0, 1.0, 7)
    v = np.cumsum(random.uniform(0.5, 2.0, 24 + closed))
    angle = 2 * math.pi * (v - v[0]) / (v[-1] - v[0])
    if closed:
        angle = angle[:-1]
    radius = 10.0 + 3.0 * (u[:, None] - 0.5)
    z = 0.3 * np.sin(3 * angle) + 0.2 * np.cos(4 * u)[:, None]
    if closed:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
    else:
        x, y = np.broadcast_arrays(4.0 * u[:, None], v)
    points = np.stack([x, y, z], axis=-1)
    return NurbsSurface.through(points, u, v, closed_v=closed), points, u, v


def test_nine_points_make_an_exact_circle():
    surface = cylinder()
    u = np.linspace(0.0, 1.0, 1001)
    points, along_u, along_v = surface.derivatives(u, np.full(1001, 0.4))
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 2.0, rtol=1e-14)
    np.testing.assert_allclose(points[:, 2], 1.2, rtol=1e-14)
    np.testing.assert_allclose(np.sum(points[:, :2] * along_u[:, :2], axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(along_v, np.broadcast_to([0.0, 0.0, 3.0], (1001, 3)), atol=1e-12)
    np.testing.assert_allclose(surface.normal(u, np.full(1001, 0.4))[:, :2], points[:, :2] / 2.0, atol=1e-12)
    # All four quarters are traversed.
    assert np.unwrap(np.arctan2(points[:, 1], points[:, 0]))[-1] == pytest.approx(2 * math.pi)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_basis_sums_to_one_and_agrees_with_scipy(degree: int):
    random = np.random.default_rng(degree)
    inner = np.sort(random.uniform(0.0, 1.0, 6))
    inner[2] = inner[3]  # a double knot
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    t = np.concatenate([[0.0, 1.0], random.uniform(0.0, 1.0, 200)])
    first, values = basis(knots, degree, t)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-13)
    assert values.min() >= 0.0
    dense = np.zeros((len(t), len(knots) - degree - 1))
    np.put_along_axis(dense, first[:, None] + np.arange(degree + 1), values, axis=1)
    np.testing.assert_allclose(dense, BSpline.design_matrix(t, knots, degree).toarray(), atol=1e-13)
    slopes = basis(knots, degree, t, order=1)[1]
    np.testing.assert_allclose(slopes.sum(axis=1), 0.0, atol=1e-10)


@pytest.mark.parametrize("surface", [cylinder(), wavy()[0], wavy(closed=True)[0]])
def test_derivatives_against_differences(surface: NurbsSurface):
    random = np.random.default_rng(4)
    h = 1.0e-6
    u = random.uniform(surface.range_u[0] + h, surface.range_u[1] - h, 100)
    v = random.uniform(surface.range_v[0] + h, surface.range_v[1] - h, 100)
    points, along_u, along_v = surface.derivatives(u, v)
    np.testing.assert_allclose(points, surface.point(u, v), atol=1e-14)
    np.testing.assert_allclose((surface.point(u + h, v) - surface.point(u - h, v)) / (2 * h), along_u, atol=2e-7)
    np.testing.assert_allclose((surface.point(u, v + h) - surface.point(u, v - h)) / (2 * h), along_v, atol=2e-7)
    normals = surface.normal(u, v)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sum(normals * along_u, axis=1), 0.0, atol=1e-12)


def test_grids_agree_with_points():
    for surface in (cylinder(), wavy()[0], wavy(closed=True)[0]):
        u, v = np.linspace(*surface.range_u, 11), np.linspace(*surface.range_v, 17)
        np.testing.assert_allclose(surface.grid(u, v), surface.point(u[:, None], v), atol=1e-13)
        points, normals = surface.grid_normals(u, v)
        np.testing.assert_allclose(points, surface.point(u[:, None], v), atol=1e-13)
        np.testing.assert_allclose(normals, surface.normal(u[:, None], v), atol=1e-12)


def test_a_surface_goes_through_its_points():
    for closed in (False, True):
        surface, points, u, v = wavy(closed)
        columns = v[:-1] if closed else v
        np.testing.assert_allclose(surface.grid(u, columns), points, atol=1e-12)
    start, end = (surface.derivatives(u, np.full(len(u), t)) for t in surface.range_v)
    for at_start, at_end in zip(start, end, strict=True):
        np.testing.assert_allclose(at_start, at_end, atol=1e-10)


def test_what_is_straight_stays_straight():
    """Linear precision: a plane through unevenly spaced points is a plane, evenly parametrised."""
    u, v = np.array([0.0, 1.0, 1.5, 4.0, 5.0]), np.array([0.0, 2.0, 3.0, 7.0])
    x, y = np.meshgrid(u, v, indexing="ij")
    surface = NurbsSurface.through(np.stack([x, y, 0.1 * x - 0.3 * y], axis=-1), u, v)
    t = np.random.default_rng(0).uniform(0.0, 1.0, (50, 2)) * [5.0, 7.0]
    expected = np.c_[t, 0.1 * t[:, 0] - 0.3 * t[:, 1]]
    np.testing.assert_allclose(surface.point(t[:, 0], t[:, 1]), expected, atol=1e-12)


def test_parameters_are_found_from_above():
    surface, _, _, _ = wavy(closed=True)
    random = np.random.default_rng(9)
    u, v = random.uniform(0.0, 1.0, 200), random.uniform(*surface.range_v, 200)
    places = surface.point(u, v)[:, :2]
    found_u, found_v = surface.parameters_at(places, u + 0.05, np.clip(v + 0.2, *surface.range_v))
    np.testing.assert_allclose(surface.point(found_u, found_v)[:, :2], places, atol=1e-9)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="knots"):
        NurbsSurface(np.zeros((4, 4, 3)), np.arange(8.0), np.arange(7.0))
    with pytest.raises(ValueError, match="weights"):
        NurbsSurface(np.zeros((4, 4, 3)), np.arange(8.0), np.arange(8.0), weights=np.ones((4, 3)))
