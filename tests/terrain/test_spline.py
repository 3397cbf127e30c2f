"""The centreline: closed forms, arc length, the closest point against brute force, and long walks with memory."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import numpy as np
import pytest
import warp as wp

from echelon.errors import InputError
from echelon.terrain.spline import Centreline
from echelon.terrain.spline_kernels import (
    CentrelineData,
    centreline_closest,
    centreline_curvature,
    centreline_find,
    centreline_grade,
    centreline_position,
    centreline_tangent,
)


@wp.kernel
def ask(
    path: CentrelineData,
    s: wp.array[wp.float32],
    # out
    positions_out: wp.array[wp.vec3],
    tangents_out: wp.array[wp.vec3],
    shapes_out: wp.array[wp.vec2],
):
    i = wp.tid()
    positions_out[i] = centreline_position(path, s[i])
    tangents_out[i] = centreline_tangent(path, s[i])
    shapes_out[i] = wp.vec2(centreline_curvature(path, s[i]), centreline_grade(path, s[i]))


@wp.kernel
def find_and_walk(
    path: CentrelineData,
    points: wp.array[wp.vec2],
    near: wp.array[wp.float32],
    # out
    found_out: wp.array[wp.vec2],
    walked_out: wp.array[wp.vec2],
):
    i = wp.tid()
    found_out[i] = centreline_find(path, points[i])
    walked_out[i] = centreline_closest(path, points[i], near[i])


@wp.kernel
def ride_along(
    path: CentrelineData,
    points: wp.array2d[wp.vec2],
    # out
    places_out: wp.array2d[wp.vec2],
):
    """Each agent through its points in order, remembering where it was."""
    agent = wp.tid()
    s = centreline_find(path, points[agent, 0])[0]
    for k in range(points.shape[1]):
        place = centreline_closest(path, points[agent, k], s)
        s = place[0]
        places_out[agent, k] = place


def on_device(path: Centreline, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, tangents and (curvature, grade) from a kernel."""
    positions, tangents = (wp.zeros(len(s), dtype=wp.vec3, device="cpu") for _ in range(2))
    shapes = wp.zeros(len(s), dtype=wp.vec2, device="cpu")
    asked = wp.array(s, dtype=wp.float32, device="cpu")
    wp.launch(ask, len(s), [path.data("cpu"), asked], [positions, tangents, shapes], device="cpu")
    return positions.numpy(), tangents.numpy(), shapes.numpy()


def closest_on_device(path: Centreline, points: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a search and a walk find in a kernel, (s, offset) each."""
    found, walked = (wp.zeros(len(points), dtype=wp.vec2, device="cpu") for _ in range(2))
    inputs = [
        path.data("cpu"),
        wp.array(points, dtype=wp.vec2, device="cpu"),
        wp.array(near, dtype=wp.float32, device="cpu"),
    ]
    wp.launch(find_and_walk, len(points), inputs, [found, walked], device="cpu")
    return found.numpy(), walked.numpy()


def circle(radius: float, count: int, climb: float = 0.0) -> Centreline:
    """Points on a circle, counter-clockwise; the height goes up and down once by `climb`."""
    angle = 2 * math.pi * np.arange(count) / count
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), climb * np.sin(angle)], axis=1)
    return Centreline(points, closed=True)


def ring_road() -> Centreline:
    """A closed road of about 13 km with bends, hills and unevenly set points."""
    random = np.random.default_rng(7)
    angle = np.sort(random.uniform(0.0, 2 * math.pi, 130) + 2 * math.pi * np.arange(130)) / 130
    radius = 1750.0 + 180.0 * np.sin(5 * angle) + 60.0 * np.sin(11 * angle)
    height = 30.0 * np.sin(3 * angle) + 12.0 * np.cos(8 * angle)
    return Centreline(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1), closed=True)


def corner() -> Centreline:
    """An open road with a right angle of about four metres' radius and a hairpin."""
    points = [
        (0, 0, 0),
        (40, 0, 1),
        (56, 0, 2),
        (60, 4, 2.5),
        (60, 30, 3),
        (57, 36, 3),
        (50, 36, 3),
        (47, 30, 3),
        (47, 9, 1),
    ]
    return Centreline(np.array(points, dtype=float), closed=False)


# ---- closed forms ----------------------------------------------------------------------------------------------------
def test_a_straight_line_is_straight():
    path = Centreline(np.array([[1.0, 2.0, 0.0], [4.0, 6.0, 0.5], [31.0, 42.0, 5.0]]), closed=False)
    assert path.length == pytest.approx(math.hypot(30.0, 40.0, 5.0))
    s = np.linspace(0.0, path.length, 41)
    expected = np.array([1.0, 2.0, 0.0]) + np.outer(s / path.length, [30.0, 40.0, 5.0])
    np.testing.assert_allclose(path.position(s), expected, atol=1e-9)
    np.testing.assert_allclose(path.curvature(s), 0.0, atol=1e-9)
    np.testing.assert_allclose(path.grade(s), 0.1, atol=1e-9)
    np.testing.assert_allclose(path.left(s), np.broadcast_to([-0.8, 0.6], (41, 2)), atol=1e-9)
    s_closest, offset = path.closest(np.array([16.0 - 0.8, 22.0 + 0.6]))
    assert s_closest == pytest.approx(0.5 * path.length)
    assert offset == pytest.approx(1.0)


def test_an_open_line_goes_on_straight():
    path = Centreline(np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 1.0], [20.0, 0.0, 2.0]]), closed=False)
    beyond = path.length + math.hypot(5.0, 0.5)
    np.testing.assert_allclose(path.position(beyond), [25.0, 0.0, 2.5], atol=1e-9)
    s, offset = path.closest(np.array([[25.0, 2.0], [-5.0, -3.0]]))
    np.testing.assert_allclose(s[0], path.length + 5.0 / math.cos(math.atan(0.1)), atol=1e-9)
    np.testing.assert_allclose(offset, [2.0, -3.0], atol=1e-9)
    found, walked = closest_on_device(path, np.array([[25.0, 2.0], [-5.0, -3.0]]), np.array([1.0, 1.0]))
    np.testing.assert_allclose(found, np.stack([s, offset], axis=1), atol=1e-5)
    np.testing.assert_allclose(walked, found, atol=1e-6)
    np.testing.assert_allclose(on_device(path, np.array([beyond]))[0], [[25.0, 0.0, 2.5]], atol=1e-5)


@pytest.mark.parametrize("radius", [5.0, 50.0, 2000.0])
def test_a_circle_is_round(radius: float):
    path = circle(radius, 64)
    # The spline cuts corners of the polygon's circle by parts in ten thousand: (pi / 32)^4 of the radius and less.
    assert path.length == pytest.approx(2 * math.pi * radius, rel=1e-4)
    s = np.linspace(0.0, path.length, 500)
    np.testing.assert_allclose(np.linalg.norm(path.position(s)[:, :2], axis=1), radius, rtol=1e-4)
    np.testing.assert_allclose(path.curvature(s), 1.0 / radius, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(path.tangent(s), axis=1), 1.0, atol=1e-12)
    inside = 0.8 * path.position(s)[:, :2]
    _, offset = path.closest(inside)
    np.testing.assert_allclose(offset, 0.2 * radius, rtol=1e-3)  # the inside of a bend to the left is left
    assert path.closest(np.array([1.3 * radius, 0.0]))[1] == pytest.approx(-0.3 * radius, rel=1e-3)


def test_evenly_spaced_points_give_the_uniform_formula():
    p = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [8.0, 4.0, 0.0], [11.0, 0.0, 0.0]])  # chords of 5 m
    path = Centreline(p, closed=False)
    t = np.linspace(0.0, 1.0, 9)[:, None]
    expected = 0.5 * (
        2 * p[1]
        + (p[2] - p[0]) * t
        + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * t**2
        + (-p[0] + 3 * p[1] - 3 * p[2] + p[3]) * t**3
    )
    s, offset = path.closest(expected[:, :2], near=0.5 * path.length)
    np.testing.assert_allclose(offset, 0.0, atol=1e-4)
    assert s[0] == pytest.approx(path.point_s[1], abs=1e-3)
    assert s[-1] == pytest.approx(path.point_s[2], abs=1e-3)


def test_it_passes_through_its_points():
    for path in (ring_road(), corner(), circle(30.0, 12, climb=2.0)):
        np.testing.assert_allclose(path.position(path.point_s), path.points, atol=5e-4)


def test_no_overshoot_where_points_are_uneven():
    """Close points beside distant ones: with the uniform parameter it would swing 15 m wide and loop back."""
    path = Centreline(np.array([[0, 0, 0], [200, 0, 0], [201, 1, 0], [201, 200, 0]], dtype=float), closed=False)
    xy = path.samples[:, :2]
    assert xy[:, 0].max() < 203.5
    assert xy[:, 1].min() > -2.5
    heading = np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))
    assert heading.max() - heading.min() < math.radians(150.0)


# ---- arc length ------------------------------------------------------------------------------------------------------
def test_s_is_arc_length():
    for path in (ring_road(), corner()):
        fine = path.position(np.linspace(0.0, path.length, 400_000))
        walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        np.testing.assert_allclose(walked, np.linspace(0.0, path.length, 400_000), atol=2e-3)


def test_derivatives_agree_with_differences():
    path = ring_road()
    s = np.random.default_rng(3).uniform(0.0, path.length, 300)
    h = 1.0e-3
    ahead, behind = path.position(s + h), path.position(s - h)
    np.testing.assert_allclose((ahead - behind) / (2 * h), path.tangent(s), atol=1e-5)
    run = np.linalg.norm((ahead - behind)[:, :2], axis=1)
    np.testing.assert_allclose((ahead - behind)[:, 2] / run, path.grade(s), atol=1e-5)
    before, after = (np.arctan2(*path.tangent(s + d)[:, 1::-1].T) for d in (-0.3, 0.3))
    turned = (after - before + math.pi) % (2 * math.pi) - math.pi
    # Curvature jumps at given points, and s runs in space, not in plan.
    np.testing.assert_allclose(turned / 0.6 / np.cos(np.arctan(path.grade(s))), path.curvature(s), atol=1e-3)


def test_kernels_agree_with_the_host():
    for path in (ring_road(), corner()):
        s = np.random.default_rng(5).uniform(0.0, path.length, 2000).astype(np.float32)
        positions, tangents, shapes = on_device(path, s)
        # Over 13 km a float32 of s is a millimetre.
        np.testing.assert_allclose(positions, path.position(s), atol=2e-3)
        # Tangents are interpolated between samples, which shows where four metres turn a right angle.
        np.testing.assert_allclose(tangents, path.tangent(s), atol=1e-4 if path.closed else 4e-3)
        np.testing.assert_allclose(shapes[:, 0], path.curvature(s), atol=2e-3 if path.closed else 5e-3)
        np.testing.assert_allclose(shapes[:, 1], path.grade(s), atol=1e-4 if path.closed else 1e-3)


def test_a_closed_line_wraps():
    path = circle(20.0, 16)
    s = np.array([3.0, path.length - 1.0])
    np.testing.assert_allclose(path.position(s - path.length), path.position(s), atol=1e-9)
    np.testing.assert_allclose(on_device(path, s + path.length)[0], path.position(s), atol=1e-4)
    assert path.difference(1.0, path.length - 1.0) == pytest.approx(2.0)


# ---- closest point ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("make", [ring_road, corner])
def test_closest_against_brute_force(make):
    path = make()
    random = np.random.default_rng(11)
    s = random.uniform(0.0, path.length, 300)
    sideways = random.uniform(-3.5, 3.5, 300)
    points = path.position(s)[:, :2] + sideways[:, None] * path.left(s)
    # All of it every half metre, then every millimetre around the best.
    coarse_s = np.arange(0.0, path.length, 0.5)
    coarse = path.position(coarse_s)[:, :2]
    best = np.array([coarse_s[np.argmin(np.sum((coarse - point) ** 2, axis=1))] for point in points])
    fine_s = best[:, None] + np.arange(-0.5, 0.5, 0.001)
    fine = path.position(fine_s if path.closed else np.clip(fine_s, 0.0, path.length))[..., :2]
    nearest = np.linalg.norm(fine - points[:, None], axis=2).min(axis=1)
    near = s + random.uniform(-1.5, 1.5, 300)
    host_s, host_offset = path.closest(points)
    walked_s, walked_offset = path.closest(points, near=s)
    found, walked = closest_on_device(path, points, near)
    beyond = (host_s < 0.0) | (host_s > path.length)  # there the line goes on, which the brute force does not know
    assert beyond.mean() < 0.1
    for offset in (host_offset, walked_offset, found[:, 1], walked[:, 1]):
        np.testing.assert_allclose(np.abs(offset)[~beyond], nearest[~beyond], atol=1e-3)
    for result in (host_s, walked_s, found[:, 0], walked[:, 0]):
        error = np.abs(path.difference(result, host_s))
        assert np.quantile(error, 0.99) < 5e-3  # inside a tight bend, two places may be as near
        np.testing.assert_allclose(
            path.position(result)[:, :2][~beyond], path.position(host_s)[:, :2][~beyond], atol=0.3
        )


def test_memory_stays_on_its_stretch():
    """Where two stretches cross, the one remembered goes on, not the one that happens to be nearer."""
    t = 2 * math.pi * np.arange(40) / 40
    eight = Centreline(np.stack([60 * np.sin(t), 30 * np.sin(2 * t), np.zeros(40)], axis=1), closed=True)
    s = np.linspace(0.0, eight.length, 4000, endpoint=False)
    rng = np.random.default_rng(0)
    offsets = np.where(rng.random(4000) < 0.5, 1.5, -1.5)
    points = eight.position(s)[:, :2] + offsets[:, None] * eight.left(s)
    _, walked = closest_on_device(eight, points, s)
    np.testing.assert_allclose(eight.difference(walked[:, 0], s), 0.0, atol=2e-3)
    np.testing.assert_allclose(walked[:, 1], offsets, atol=2e-3)
    host = eight.closest(points, near=s)
    np.testing.assert_allclose(eight.difference(host[0], s), 0.0, atol=1e-6)


def test_walking_the_whole_road_with_memory():
    path = ring_road()
    s = np.arange(0.0, path.length + 20.0, 0.5)  # 15 m/s at 30 frames a second, over the seam
    lanes = np.array([-4.0, 0.3, 4.0])
    points = path.position(s)[None, :, :2] + lanes[:, None, None] * path.left(s)[None]
    places = wp.zeros(points.shape[:2], dtype=wp.vec2, device="cpu")
    asked = wp.array(points, dtype=wp.vec2, device="cpu")
    wp.launch(ride_along, len(lanes), [path.data("cpu"), asked], [places], device="cpu")
    found = places.numpy()
    np.testing.assert_allclose(found[..., 1], np.broadcast_to(lanes[:, None], found.shape[:2]), atol=2e-3)
    np.testing.assert_allclose(path.difference(found[..., 0], s[None]), 0.0, atol=4e-3)


# ---- input -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("points", "closed", "says"),
    [
        (np.zeros((1, 3)), False, "1 points are too few; an open one needs at least 2"),
        (np.zeros((2, 3)), True, "a closed one needs at least 3"),
        (np.zeros((4, 2)), False, "not rows of x, y, z"),
        (np.array([[0.0, 0, 0], [1, 0, np.nan], [2, 0, 0]]), False, "point 1 is"),
        (
            np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 5], [2, 1, 0]]),
            False,
            r"points 1 and 2 are the same place \(1, 0\)",
        ),
        (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]]), True, "points 3 and 0"),
    ],
)
def test_bad_points_are_named(points: np.ndarray, closed: bool, says: str):
    with pytest.raises(InputError, match=says):
        Centreline(points, closed=closed)
