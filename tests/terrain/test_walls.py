"""Fences as segments: the nearest wall against plain geometry, and the set pieces as plain data."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import warp as wp
from scipy.spatial import KDTree

from echelon.scenario import CorralSettings, WorldSettings
from echelon.terrain.walls import (
    NO_WALL,
    WallGrid,
    infield_walls,
    nearest_wall,
    nearest_wall_within,
    segments,
    wall_array,
    wall_grid,
    world_dict,
)

WORLD = WorldSettings(corral=CorralSettings(center=(38.0, 0.0)))
REACH = 3.0  # [m]


@wp.kernel
def find_among_all(points: wp.array[wp.vec2], walls: wp.array[wp.vec4], found_out: wp.array[wp.vec4]):
    i = wp.tid()
    found_out[i] = nearest_wall(points[i], walls)


@wp.kernel
def find_in_cell(points: wp.array[wp.vec2], grid: WallGrid, found_out: wp.array[wp.vec4]):
    i = wp.tid()
    found_out[i] = nearest_wall_within(points[i], grid)


def from_all(points: np.ndarray, world: WorldSettings) -> np.ndarray:
    found = wp.zeros(len(points), dtype=wp.vec4, device="cpu")
    places = wp.array(points, dtype=wp.vec2, device="cpu")
    wp.launch(find_among_all, len(points), [places, wall_array(world, "cpu")], [found], device="cpu")
    return found.numpy()


def from_cell(points: np.ndarray, world: WorldSettings, reach: float) -> np.ndarray:
    found = wp.zeros(len(points), dtype=wp.vec4, device="cpu")
    places = wp.array(points, dtype=wp.vec2, device="cpu")
    wp.launch(find_in_cell, len(points), [places, wall_grid(world, reach, "cpu")], [found], device="cpu")
    return found.numpy()


def sampled_distances(points: np.ndarray, world: WorldSettings) -> np.ndarray:
    """Distance of every point to the nearest of thousands of points on the walls, at most 12 mm apart."""
    walls = segments(infield_walls(world)).astype(np.float64)
    part = np.linspace(0.0, 1.0, 3001)[:, None, None]
    samples = walls[:, :2] + part * (walls[:, 2:] - walls[:, :2])
    return KDTree(samples.reshape(-1, 2)).query(points)[0]


def random_points(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-48.0, -31.0], [48.0, 31.0], (count, 2)).astype(np.float32)


def test_nearest_wall_is_the_nearest_of_all() -> None:
    points = random_points(2000)
    found = from_all(points, WORLD)
    # No sample is nearer, and the nearest sample is hardly farther.
    expected = sampled_distances(points, WORLD)
    assert np.all(found[:, 2] <= expected + 1e-5)
    assert np.all(found[:, 2] >= expected - 6e-3)
    np.testing.assert_allclose(np.linalg.norm(found[:, :2] - points, axis=1), found[:, 2], atol=1e-5)
    on_wall = segments(infield_walls(WORLD))[found[:, 3].astype(int)]
    along, gap = on_wall[:, 2:] - on_wall[:, :2], found[:, :2] - on_wall[:, :2]
    off_line = (along[:, 0] * gap[:, 1] - along[:, 1] * gap[:, 0]) / np.linalg.norm(along, axis=1)
    np.testing.assert_allclose(off_line, 0.0, atol=1e-5)


def test_cells_know_every_wall_within_reach() -> None:
    points = random_points(4000, seed=2)
    all_walls, near = from_all(points, WORLD), from_cell(points, WORLD, REACH)
    within = all_walls[:, 2] < REACH
    assert within.sum() > 500
    np.testing.assert_array_equal(near[within], all_walls[within])
    seen = near[~within]
    assert np.all((seen[:, 3] < 0.0) | (seen[:, 2] >= REACH))


@pytest.mark.parametrize("point", [(math.nan, 0.0), (math.inf, 1.0), (-1e30, 0.0), (1e4, -1e4)])
def test_a_point_that_is_nowhere_has_no_wall_in_reach(point: tuple[float, float]) -> None:
    found = from_cell(np.array([point], dtype=np.float32), WORLD, REACH)[0]
    assert found[3] == -1.0
    assert found[2] == pytest.approx(float(NO_WALL))


def test_open_ground_has_no_walls() -> None:
    world = WorldSettings(ground="plane")
    points = random_points(5)
    assert len(segments(infield_walls(world))) == 0
    for found in (from_all(points, world), from_cell(points, world, REACH)):
        np.testing.assert_array_equal(found[:, 3], -1.0)
        np.testing.assert_array_equal(found[:, :2], points)


def test_of_equally_near_walls_the_first_is_named() -> None:
    corner = np.array([[43.0, 5.0], [43.5, 5.5]], dtype=np.float32)  # back corner of the corral, and beyond it
    found = from_all(corner, WORLD)
    corral_start = len(infield_walls(WORLD)[0].segments())
    np.testing.assert_array_equal(found[:, 3], corral_start + 2.0)
    np.testing.assert_allclose(found[:, 2], [0.0, math.hypot(0.5, 0.5)], atol=1e-6)


@pytest.mark.parametrize(("half_length", "half_width"), [(45.0, 28.0), (30.0, 30.0)])
def test_the_infield_is_a_closed_oval(half_length: float, half_width: float) -> None:
    (infield,) = infield_walls(WorldSettings(half_length=half_length, half_width=half_width))
    points = np.array(infield.points)
    straight = half_length - half_width
    from_axis = np.hypot(np.maximum(np.abs(points[:, 0]) - straight, 0.0), points[:, 1])
    np.testing.assert_allclose(from_axis, half_width, rtol=1e-12)
    pieces = infield.segments()
    np.testing.assert_array_equal(pieces[:, 2:], np.roll(pieces[:, :2], -1, axis=0))
    assert np.linalg.norm(pieces[:, 2:] - pieces[:, :2], axis=1).min() > 0.1
    area = 0.5 * np.sum(pieces[:, 0] * pieces[:, 3] - pieces[:, 2] * pieces[:, 1])
    exact = math.pi * half_width**2 + 4.0 * straight * half_width
    assert area == pytest.approx(exact, rel=4e-3)  # positive: counter-clockwise


def test_the_corral_leaves_its_opening_free() -> None:
    corral = infield_walls(WORLD)[1]
    assert corral.name == "corral"
    assert not corral.closed
    pieces = corral.segments()
    assert np.linalg.norm(pieces[:, 2:] - pieces[:, :2], axis=1).sum() == pytest.approx(4 * 10.0 - 6.0)
    posts = np.array(corral.points)[[0, -1]]
    np.testing.assert_allclose(np.sort(posts[:, 1]), [-3.0, 3.0])
    np.testing.assert_allclose(posts[:, 0], 33.0)


def test_the_world_is_plain_data() -> None:
    data = world_dict(WORLD)
    assert json.loads(json.dumps(data)) == data
    assert data["ground"] == {"shape": "oval", "half_length": 45.0, "half_width": 28.0}
    assert [(wall["name"], wall["closed"], wall["height"]) for wall in data["walls"]] == [
        ("infield", True, 1.2),
        ("corral", False, 1.2),
    ]
    assert data["corral"] == {"center": [38.0, 0.0], "size": 10.0, "opening": 6.0, "facing": [-1.0, 0.0]}
    plane = world_dict(WorldSettings(ground="plane", half_length=70.0))
    assert plane == {"ground": {"shape": "plane", "half_size": 70.0}, "walls": []}
