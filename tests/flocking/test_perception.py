"""Seeing a way round the corral, and the limits of approach; against plain geometry."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
import warp as wp

from echelon.flocking.perception import Pen, is_inside, limit_approach, limit_approach_to_walls, pen_of, way_to
from echelon.scenario import CorralSettings, WorldSettings
from echelon.terrain.walls import WallGrid, wall_grid

CORRAL = CorralSettings(center=(10.0, -4.0), size=10.0, opening=6.0, facing=(0.0, 1.0))
WORLD = WorldSettings(ground="plane", corral=CORRAL)
CLEARANCE = 1.0


@wp.kernel
def find_ways(
    starts: wp.array[wp.vec2], ends: wp.array[wp.vec2], pen: Pen, ways_out: wp.array[wp.vec3], inside_out: wp.array[int]
):
    i = wp.tid()
    ways_out[i] = way_to(starts[i], ends[i], CLEARANCE, pen)
    inside_out[i] = wp.where(is_inside(starts[i], pen), 1, 0)


@wp.kernel
def limit_all(
    velocities: wp.array[wp.vec2], places: wp.array[wp.vec2], gain: float, walls: WallGrid, out: wp.array[wp.vec2]
):
    i = wp.tid()
    out[i] = limit_approach_to_walls(velocities[i], places[i], gain, 1.0, walls)


@wp.kernel
def limit_one(velocity: wp.vec2, toward: wp.vec2, fastest: float, out: wp.array[wp.vec2]):
    out[0] = limit_approach(velocity, toward, fastest)


def ways(starts: np.ndarray, ends: np.ndarray, world: WorldSettings = WORLD) -> tuple[np.ndarray, np.ndarray]:
    count = len(starts)
    arrays = [wp.array(np.asarray(p, dtype=np.float32), dtype=wp.vec2, device="cpu") for p in (starts, ends)]
    found = wp.zeros(count, dtype=wp.vec3, device="cpu")
    inside = wp.zeros(count, dtype=int, device="cpu")
    wp.launch(find_ways, count, [*arrays, pen_of(world)], [found, inside], device="cpu")
    return found.numpy(), inside.numpy()


def crosses(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the segment from a to b properly crosses a piece of the corral's fence, by orientations."""
    posts = CORRAL.fences()
    a, b = a.tolist(), b.tolist()

    def turn(p: Sequence[float], q: Sequence[float], r: Sequence[float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return any(turn(p, q, a) * turn(p, q, b) < 0 and turn(a, b, p) * turn(a, b, q) < 0 for p, q in pairwise(posts))


def test_ways_are_straight_where_no_fence_is_between() -> None:
    random = np.random.default_rng(5)
    starts, ends = (random.uniform([-2.0, -16.0], [22.0, 10.0], (1000, 2)) for _ in range(2))
    found, _ = ways(starts, ends)
    straight = np.abs(found[:, :2] - ends).max(axis=1) < 1e-4
    expected = np.array([not crosses(a, b) for a, b in zip(starts, ends, strict=True)])
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(straight, expected)
    lengths = np.linalg.norm(ends - starts, axis=1)
    np.testing.assert_allclose(found[straight, 2], lengths[straight], rtol=1e-5)
    assert np.all(found[~straight, 2] >= lengths[~straight] - 1e-4)


def test_ways_round_the_fence_get_there() -> None:
    """Following first legs leads from anywhere to anywhere without crossing the fence."""
    random = np.random.default_rng(6)
    places, ends = (random.uniform([0.0, -14.0], [20.0, 8.0], (400, 2)) for _ in range(2))
    clear = np.abs(np.abs(places - CORRAL.center).max(axis=1) - 5.0) > 0.3
    places, ends = places[clear], ends[clear]
    for _ in range(6):
        found, _ = ways(places, ends)
        for place, leg in zip(places, found[:, :2], strict=True):
            assert not crosses(place, leg), f"from {place} toward {leg}"
        places = found[:, :2].astype(np.float64)
    np.testing.assert_allclose(places, ends, atol=1e-3)


def test_inside_is_inside() -> None:
    places = np.array([[10.0, -4.0], [5.1, -8.9], [14.9, 0.9], [4.9, -4.0], [10.0, 1.1]])
    np.testing.assert_array_equal(ways(places, places)[1], [1, 1, 1, 0, 0])
    nowhere = WorldSettings(ground="plane")
    np.testing.assert_array_equal(ways(places, places[::-1], nowhere)[1], 0)
    np.testing.assert_allclose(ways(places, places[::-1], nowhere)[0][:, :2], places[::-1])


@pytest.mark.parametrize(
    ("fastest", "expected"), [(2.0, (1.0, 1.0)), (0.5, (0.5, 1.0)), (0.0, (0.0, 1.0)), (-0.5, (-0.5, 1.0))]
)
def test_approach_is_limited_and_motion_alongside_is_free(fastest: float, expected: tuple[float, float]) -> None:
    out = wp.zeros(1, dtype=wp.vec2, device="cpu")
    wp.launch(limit_one, 1, [wp.vec2(1.0, 1.0), wp.vec2(1.0, 0.0), fastest], [out], device="cpu")
    np.testing.assert_allclose(out.numpy()[0], expected)


def test_walls_limit_the_speed_toward_them() -> None:
    places = np.array([[10.0, -8.0], [10.0, -6.0], [10.0, -4.0], [10.0, -8.5], [14.5, -8.5]], dtype=np.float32)
    velocities = np.tile(np.array([0.3, -2.0], dtype=np.float32), (5, 1))
    velocities[4] = [2.0, -2.0]
    out = wp.zeros(5, dtype=wp.vec2, device="cpu")
    arrays = [wp.array(values, dtype=wp.vec2, device="cpu") for values in (velocities, places)]
    wp.launch(limit_all, 5, [*arrays, 1.0, wall_grid(WORLD, 3.0, "cpu")], [out], device="cpu")
    # A metre and less before the back fence at y = -9: stop, and back away; farther off more is allowed.
    expected = [[0.3, 0.0], [0.3, -2.0], [0.3, -2.0], [0.3, 0.5], [-0.5, 0.5]]
    np.testing.assert_allclose(out.numpy(), expected, atol=1e-6)
