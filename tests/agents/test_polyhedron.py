"""Mass properties of polyhedra, against formulas and against sampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from echelon.agents.polyhedron import Polyhedron, convex_hull, moments
from echelon.errors import InputError

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Polyhedron:
    return convex_hull(np.array(low) + CORNERS * np.subtract(high, low))


def combined(parts: list[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Masses, centres and inertia tensors taken together."""
    mass = sum(part[0] for part in parts)
    center = np.asarray(sum(m * c for m, c, _ in parts)) / mass
    inertia = np.zeros((3, 3))
    for m, c, tensor in parts:
        r = c - center
        inertia += tensor + m * (r @ r * np.eye(3) - np.outer(r, r))
    return mass, center, inertia


def box_properties(
    low: tuple[float, float, float], high: tuple[float, float, float], density: float
) -> tuple[float, np.ndarray, np.ndarray]:
    size = np.subtract(high, low)
    mass = density * float(size.prod())
    x, y, z = size**2
    return mass, 0.5 * np.add(low, high), mass / 12.0 * np.diag([y + z, x + z, x + y])


def test_a_box_is_exact_far_from_the_origin():
    low, high = (10.0, -20.0, 30.0), (10.2, -19.5, 30.9)
    found = box(low, high).mass_properties(1_040.0)
    mass, center, inertia = box_properties(low, high, 1_040.0)
    assert found.volume == pytest.approx(0.09, rel=1e-12)
    assert found.mass == pytest.approx(mass, rel=1e-12)
    np.testing.assert_allclose(found.center, center, rtol=1e-14)
    np.testing.assert_allclose(found.inertia, inertia, rtol=1e-11, atol=1e-11)


def test_a_corner_tetrahedron_has_its_textbook_moments():
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 5.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    found = Polyhedron(points, triangles).mass_properties(6.0)
    assert found.mass == pytest.approx(30.0, rel=1e-13)
    np.testing.assert_allclose(found.center, (0.5, 0.75, 1.25), rtol=1e-13)
    # About the right-angled corner: integral of x^2 is V a^2 / 10, of x y it is V a b / 20.
    a = np.array([2.0, 3.0, 5.0])
    second = 30.0 * (np.outer(a, a) / 20.0 + np.diag(a**2) / 20.0)
    c = np.array(found.center)
    second -= 30.0 * np.outer(c, c)
    np.testing.assert_allclose(found.inertia, np.trace(second) * np.eye(3) - second, rtol=1e-12, atol=1e-12)


def l_shape() -> Polyhedron:
    """An L: a square of 2 by 2 by 1 without one of its quarters, as one closed surface with a reentrant edge."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    points = np.concatenate([np.column_stack([outline, np.zeros(6)]), np.column_stack([outline, np.ones(6)])])
    floor = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4]]
    roof = [[6 + a, 6 + c, 6 + b] for a, b, c in floor]
    sides = [
        triangle for i in range(6) for triangle in ([i, (i + 1) % 6, 6 + (i + 1) % 6], [i, 6 + (i + 1) % 6, 6 + i])
    ]
    return Polyhedron(points, np.array(floor + roof + sides))


def test_a_solid_that_is_not_convex_is_exact():
    found = l_shape().mass_properties(2.0)
    boxes = [((0.0, 0.0, 0.0), (2.0, 1.0, 1.0)), ((0.0, 1.0, 0.0), (1.0, 2.0, 1.0))]
    mass, center, inertia = combined([box_properties(low, high, 2.0) for low, high in boxes])
    assert found.mass == pytest.approx(mass, rel=1e-13)
    np.testing.assert_allclose(found.center, center, rtol=1e-13)
    np.testing.assert_allclose(found.inertia, inertia, rtol=1e-12, atol=1e-12)


def test_a_hollow_is_taken_away():
    outer, inner = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), box((0.2, 0.2, 0.2), (0.5, 0.7, 0.8))
    shell = Polyhedron(
        np.concatenate([outer.points, inner.points]),
        np.concatenate([outer.triangles, inner.triangles[:, ::-1] + len(outer.points)]),
    )
    found = shell.mass_properties(1.0)
    hole = box_properties((0.2, 0.2, 0.2), (0.5, 0.7, 0.8), 1.0)
    mass, center, inertia = combined(
        [box_properties((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0), (-hole[0], hole[1], -hole[2])]
    )
    assert found.mass == pytest.approx(mass, rel=1e-13)
    np.testing.assert_allclose(found.center, center, rtol=1e-12)
    np.testing.assert_allclose(found.inertia, inertia, rtol=1e-11, atol=1e-12)


@given(
    seed=st.integers(0, 10_000),
    shift=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
@settings(max_examples=40, deadline=None)
def test_moving_and_turning_a_hull_moves_and_turns_its_properties(seed: int, shift: tuple, turn: tuple):
    hull = convex_hull(np.random.default_rng(seed).normal(size=(30, 3)))
    rotation = Rotation.from_rotvec(turn).as_matrix()
    plain, moved = hull.mass_properties(3.0), Polyhedron(hull.points @ rotation.T + shift, hull.triangles)
    found = moved.mass_properties(3.0)
    assert found.mass == pytest.approx(plain.mass, rel=1e-10)
    np.testing.assert_allclose(found.center, rotation @ plain.center + shift, atol=1e-10)
    np.testing.assert_allclose(found.inertia, rotation @ plain.inertia @ rotation.T, rtol=1e-8, atol=1e-9)


def test_a_hull_agrees_with_sampling():
    rng = np.random.default_rng(3)
    hull = convex_hull(rng.normal(size=(40, 3)))
    a, b, c = (hull.points[hull.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    low, high = hull.points.min(axis=0), hull.points.max(axis=0)
    samples = low + (high - low) * rng.random((200_000, 3))
    inside = samples[np.all(samples @ normals.T <= np.einsum("ij,ij->i", normals, a), axis=1)]
    found = hull.mass_properties(1.0)
    assert found.volume == pytest.approx((high - low).prod() * len(inside) / len(samples), rel=0.01)
    np.testing.assert_allclose(found.center, inside.mean(axis=0), atol=0.02)
    spread = np.cov(inside.T)
    np.testing.assert_allclose(found.inertia / found.mass, np.trace(spread) * np.eye(3) - spread, rtol=0.02, atol=0.02)


def test_moments_take_many_surfaces_at_once():
    hull = convex_hull(np.random.default_rng(1).normal(size=(12, 3)))
    volumes, centers, seconds = moments(np.stack([hull.points, 2.0 * hull.points + 1.0]), hull.triangles)
    assert volumes[1] == pytest.approx(8.0 * volumes[0])
    np.testing.assert_allclose(centers[1], 2.0 * centers[0] + 1.0)
    np.testing.assert_allclose(seconds[1], 32.0 * seconds[0])


def test_a_hull_keeps_only_its_corners():
    hull = convex_hull(np.concatenate([CORNERS, [[0.5, 0.5, 0.5]]]))
    assert len(hull.points) == 8
    assert len(hull.triangles) == 12


UNIT = convex_hull(CORNERS)


@pytest.mark.parametrize(
    ("points", "triangles", "message"),
    [
        (CORNERS, UNIT.triangles[:-1], r"thigh: is not closed, 3 edges"),
        (UNIT.points, UNIT.triangles[:, ::-1], r"thigh: volume is -1 m\^3"),
        (UNIT.points, np.concatenate([UNIT.triangles[:1, ::-1], UNIT.triangles[1:]]), r"thigh: is not closed"),
        (UNIT.points, UNIT.triangles + 1, r"thigh: a triangle has corner 8, there are 8 points"),
        (UNIT.points * np.nan, UNIT.triangles, r"thigh: points hold a number that is not finite"),
        (UNIT.points, UNIT.triangles[:2], r"thigh: 2 triangles enclose nothing"),
    ],
)
def test_what_encloses_nothing_is_one_line(points: np.ndarray, triangles: np.ndarray, message: str):
    with pytest.raises(InputError, match=message) as caught:
        Polyhedron(points, triangles, "thigh")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("cloud", [CORNERS[:3], CORNERS[:4], np.zeros((9, 3))])
def test_a_flat_cloud_has_no_hull(cloud: np.ndarray):
    with pytest.raises(InputError, match="span no volume"):
        convex_hull(cloud)


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf])
def test_density_is_positive(density: float):
    with pytest.raises(InputError, match=r"must be positive"):
        UNIT.mass_properties(density)
