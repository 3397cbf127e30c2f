"""Roads: heights on, beside and off the road, with no step anywhere, however sharply it bends or meets itself."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import warp as wp

from echelon.errors import InputError
from echelon.terrain.road import LAND_TOLERANCE, ROAD_TOLERANCE, RoadGround, RoadSurfaces, RoadTerrain, look_up_road
from echelon.terrain.road_display import display_meshes
from echelon.terrain.spline import Centreline
from echelon.terrain.triangulation import TriangleMesh

HALF_WIDTH = 4.0  # [m]


@wp.kernel
def look_up_all(surface: int, points: wp.array[wp.vec3d], data: RoadGround, planes_out: wp.array[wp.vec4d]):
    i = wp.tid()
    planes_out[i] = look_up_road(surface, points[i], data)


def planes(terrain: RoadTerrain, xy: np.ndarray, surface: int = 0) -> np.ndarray:
    """Planes (n, d) that sites at places on the map meet, shape [n, 4]."""
    points = wp.array(np.c_[xy, np.zeros(len(xy))], dtype=wp.vec3d, device="cpu")
    found = wp.zeros(len(xy), dtype=wp.vec4d, device="cpu")
    wp.launch(look_up_all, len(xy), [surface, points, terrain.data], [found], device="cpu")
    return found.numpy()


def felt(terrain: RoadTerrain, xy: np.ndarray) -> np.ndarray:
    """Heights of the ground that wheels feel [m], shape [n]."""
    plane = planes(terrain, xy)
    return (plane[:, 3] - np.sum(plane[:, :2] * xy, axis=1)) / plane[:, 2]


def rolling_land(xy: np.ndarray) -> np.ndarray:
    """Land that knows nothing of the road [m]."""
    return 1.5 * np.sin(xy[..., 0] / 40.0) * np.cos(xy[..., 1] / 55.0) + 0.01 * xy[..., 0]


def through_land(points: list[tuple[float, float]], closed: bool, lift: float = 0.0) -> RoadSurfaces:
    """A road over the rolling land, `lift` above it where it bends this way or that [m]."""
    flat = np.array(points, dtype=float)
    height = rolling_land(flat) + lift * np.sin(np.arange(len(flat)))
    return RoadSurfaces(
        Centreline(np.c_[flat, height], closed), HALF_WIDTH, 1.0, rolling_land, land_margin=40.0, land_spacing=8.0
    )


@cache
def winding() -> RoadSurfaces:
    angle = 2 * math.pi * np.arange(40) / 40
    radius = 110.0 + 25.0 * np.sin(3 * angle) + 6.0 * np.sin(7 * angle)
    return through_land([(r * math.cos(a), r * math.sin(a)) for a, r in zip(angle, radius, strict=True)], True, 0.5)


@cache
def sharp() -> RoadSurfaces:
    """Right angles of about three metres' radius: less than the half width."""
    return through_land(
        [(0, 0), (70, 0), (76, 0), (78, 2), (78, 8), (78, 60), (78, 66), (76, 68), (70, 68), (0, 68)], False
    )


@cache
def hairpin() -> RoadSurfaces:
    """Two stretches 13 m apart, which share their shoulders, joined by a half circle."""
    bend = [(80 + 6.5 * math.sin(a), 6.5 - 6.5 * math.cos(a)) for a in np.linspace(0.0, math.pi, 9)]
    return through_land([(0, 0), (40, 0), *bend, (40, 13), (0, 13)], False, 0.3)


@cache
def crossing() -> RoadSurfaces:
    """A figure of eight; its two stretches meet at the height of the land."""
    t = 2 * math.pi * np.arange(48) / 48
    return through_land([(90 * math.sin(a), 45 * math.sin(2 * a)) for a in t], True)


@cache
def there_and_back() -> RoadSurfaces:
    """The same street both ways, a turning circle at each end."""
    east = [(x, 0.4 * math.sin(x / 9)) for x in range(0, 121, 8)]
    back = [(x, y + 0.8) for x, y in reversed(east)]
    turn = [(128, -4), (137, -9), (146, 0), (137, 9), (128, 5)]
    other = [(-8, 5), (-17, 9), (-26, 0), (-17, -9), (-8, -4)]
    return through_land([*east, *turn, *back, *other], True)


Make = Callable[[], RoadSurfaces]

STEPS: dict[Make, float] = {
    winding: LAND_TOLERANCE,
    sharp: LAND_TOLERANCE,
    crossing: LAND_TOLERANCE,
    # Where shoulders are narrowed and end on one another at an acute angle, their surfaces agree less closely.
    hairpin: 0.008,
    there_and_back: 0.015,
}
"""Greatest step of the ground, and error of its triangles, on and beside each road [m]."""

ROADS = list(STEPS)


def around(surfaces: RoadSurfaces, count: int, seed: int) -> np.ndarray:
    """Random places, two thirds of them on the strip and just beside it, shape [count, 2]."""
    random = np.random.default_rng(seed)
    strip = surfaces.strip
    near = 2 * count // 3
    s = random.uniform(strip.start, strip.end, near)
    offset = random.uniform(-1.2, 1.2, near) * strip.limit
    places = strip.centreline.position(s)[:, :2] + offset[:, None] * strip.centreline.left(s)
    low = [surfaces.land.range_u[0], surfaces.land.range_v[0]]
    high = [surfaces.land.range_u[1], surfaces.land.range_v[1]]
    return np.concatenate([places, random.uniform(low, high, (count - near, 2))])


# ---- heights ---------------------------------------------------------------------------------------------------------
def test_a_level_straight_road_is_level_and_straight():
    line = Centreline(np.array([[0.0, 0.0, 3.0], [50.0, 0.0, 3.0], [120.0, 0.0, 3.0]]), closed=False)
    surfaces = RoadSurfaces(line, HALF_WIDTH, 1.0, lambda xy: np.full(xy.shape[:-1], 2.0), land_margin=30.0)
    across = np.array([[60.0, y] for y in (-5.0, -4.0, 0.0, 2.5, 5.0)])
    np.testing.assert_allclose(surfaces.height(across), 3.0, atol=1e-3)
    np.testing.assert_allclose(surfaces.normal(across[1:4]), np.tile([0.0, 0.0, 1.0], (3, 1)), atol=3e-3)
    np.testing.assert_allclose(surfaces.height(np.array([[60.0, 9.0], [60.0, -20.0], [60.0, 900.0]])), 2.0, atol=1e-6)
    # The shoulder goes down smoothly, half way in its middle.
    assert surfaces.height(np.array([60.0, 7.0])) == pytest.approx(2.5, abs=5e-3)
    # Beyond its ends the road goes on for a while, and then sinks into the land.
    np.testing.assert_allclose(
        surfaces.height(np.array([[-10.0, 0.0], [135.0, 1.0], [152.0, 0.0]])), [3, 3, 2], atol=2e-3
    )
    assert surfaces.on_road(np.array([[60.0, 3.9], [60.0, 4.1], [-1.0, 0.0], [119.0, -3.0]])).tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("make", [winding, sharp])
def test_the_centreline_lies_on_the_road(make: Make):
    surfaces = make()
    s = np.linspace(0.0, surfaces.centreline.length, 700)[1:-1]
    middle = surfaces.centreline.position(s)
    # Between sections the surface rounds off where the spline's second derivative jumps.
    np.testing.assert_allclose(surfaces.height(middle[:, :2]), middle[:, 2], atol=3e-3)
    flat = middle[:, :2] + 2.0 * surfaces.centreline.left(s)
    np.testing.assert_allclose(surfaces.height(flat), middle[:, 2], atol=0.02)


def test_off_the_road_the_land_is_as_given():
    surfaces = winding()
    places = around(surfaces, 3000, 3)
    distance = np.abs(surfaces.centreline.closest(places)[1])
    off = places[distance > surfaces.strip.limit]
    assert len(off) > 500
    np.testing.assert_allclose(surfaces.height(off), rolling_land(off), atol=0.01)


def test_bends_are_banked_towards_their_inside():
    angle = 2 * math.pi * np.arange(32) / 32
    line = Centreline(np.stack([30 * np.cos(angle), 30 * np.sin(angle), np.full(32, 5.0)], axis=1), closed=True)
    surfaces = RoadSurfaces(line, HALF_WIDTH, 0.0, lambda xy: np.full(xy.shape[:-1], 5.0), bank=0.06, land_margin=20.0)
    full = 0.06 * 25.0 / 30.0
    across = np.array([[30.0 + out, 0.0] for out in (-3.0, 0.0, 3.0)])
    np.testing.assert_allclose(surfaces.height(across) - 5.0, full * np.array([-3.0, 0.0, 3.0]), atol=3e-3)
    np.testing.assert_allclose(surfaces.normal(across)[:, 0], -full, atol=5e-3)


# ---- everywhere ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("make", ROADS)
def test_wheels_feel_the_surfaces_everywhere(make: Make):
    surfaces = make()
    terrain = RoadTerrain.of(surfaces, "cpu")
    places = around(surfaces, 20_000, 1)
    error = np.abs(felt(terrain, places) - surfaces.height(places))
    paved = surfaces.on_road(places)
    assert paved.sum() > 2000
    assert error[paved].max() < (ROAD_TOLERANCE if STEPS[make] == LAND_TOLERANCE else STEPS[make])
    assert np.quantile(error[paved], 0.99) < ROAD_TOLERANCE
    assert error.max() < STEPS[make]
    slope = np.linalg.norm(planes(terrain, places)[:, :3] - surfaces.normal(places), axis=1)
    assert np.quantile(slope, 0.99) < 0.025  # on shoulders, which fall off steeply here
    assert slope.max() < 0.08  # where the share of a shoulder is kinked by a narrowing


@pytest.mark.parametrize("make", ROADS)
def test_no_step_anywhere(make: Make):
    """Across seams, shoulders, and other stretches: two places a millimetre apart differ by what the slope says."""
    surfaces = make()
    terrain = RoadTerrain.of(surfaces, "cpu")
    places = around(surfaces, 60_000, 2)
    # Half of them along rays outwards, close to where the road meets the land.
    strip = surfaces.strip
    random = np.random.default_rng(5)
    s = random.uniform(0.0, strip.centreline.length, 30_000)
    left, right = strip.limits(s)
    out = np.where(random.random(30_000) < 0.5, left, -right) + random.normal(0.0, 2e-3, 30_000)
    places[:30_000] = strip.centreline.position(s)[:, :2] + out[:, None] * strip.centreline.left(s)
    angle = random.uniform(0.0, 2 * math.pi, len(places))
    step = 0.002 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    plane = planes(terrain, places)
    rise = -np.sum(plane[:, :2] * step, axis=1) / plane[:, 2]
    jump = np.abs(felt(terrain, places + step) - felt(terrain, places) - rise)
    assert np.quantile(jump, 0.99) < 0.25 * ROAD_TOLERANCE
    assert jump.max() < STEPS[make]
    assert jump[surfaces.on_road(places)].max() < 1.5 * ROAD_TOLERANCE


def test_a_wheel_rolls_smoothly():
    """Along the road, a little to the side: heights follow the slope from millimetre to millimetre, without kinks."""
    surfaces = winding()
    terrain = RoadTerrain.of(surfaces, "cpu")
    line = surfaces.centreline
    s = np.arange(5.0, 105.0, 0.002)
    places = line.position(s)[:, :2] + 1.3 * line.left(s)
    z, plane = felt(terrain, places), planes(terrain, places)
    run = np.diff(places, axis=0)
    slope = -plane[:, :2] / plane[:, 2:3]
    expected = np.sum(0.5 * (slope[1:] + slope[:-1]) * run, axis=1)
    assert np.abs(np.diff(z) - expected).max() < 5e-6
    assert np.linalg.norm(np.diff(slope, axis=0), axis=1).max() < 2e-4  # 0.1 a metre


@pytest.mark.parametrize("make", ROADS)
def test_strips_do_not_fold(make: Make):
    surfaces = make()
    u = np.linspace(0.0, 1.0, 41)
    v = np.linspace(*surfaces.road.range_v, 3001)
    points, normals = surfaces.road.grid_normals(u, v)
    assert normals[..., 2].min() > 0.3
    assert np.isfinite(points).all()


def test_there_is_ground_beyond_the_land():
    surfaces = winding()
    terrain = RoadTerrain.of(surfaces, "cpu")
    far = np.array([[1.0e4, 0.0], [0.0, -3.0e3], [-1.0e6, 1.0e6]])
    np.testing.assert_allclose(felt(terrain, far), surfaces.height(far), atol=LAND_TOLERANCE)
    np.testing.assert_allclose(planes(terrain, far)[:, :3], surfaces.normal(far), atol=5e-3)


# ---- the terrain's other half ----------------------------------------------------------------------------------------
def test_walls_stand_where_they_are_put():
    terrain = RoadTerrain.of(winding(), "cpu", obstacles=[(100.0, -1.0, 104.0, -1.0)])
    assert terrain.rough
    assert not terrain.level
    found = planes(terrain, np.array([[102.0, -0.5], [102.0, -1.7], [0.0, 0.0]]), surface=1)
    np.testing.assert_allclose(found[0], [0.0, 1.0, 0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(found[1], [0.0, -1.0, 0.0, 1.0], atol=1e-6)
    assert found[2, 3] == -1.0e6  # nothing is near
    without = RoadTerrain.of(winding(), "cpu")
    assert planes(without, np.array([[102.0, -0.5]]), surface=1)[0, 3] == -1.0e6


# ---- what is drawn ---------------------------------------------------------------------------------------------------
def areas(mesh: TriangleMesh) -> np.ndarray:
    """Signed areas of triangles on the map [m^2]."""
    a, b, c = (mesh.points[mesh.triangles[:, k], :2] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


@pytest.mark.parametrize("make", ROADS)
def test_drawn_meshes_cover_the_map_once(make: Make):
    surfaces = make()
    meshes = display_meshes(surfaces, 0.03)
    assert [mesh.name for mesh in meshes] == ["road", "verge", "land"]
    (x0, x1), (y0, y1) = surfaces.land.range_u, surfaces.land.range_v
    for mesh in meshes:
        assert areas(mesh).min() > -1e-9
        assert mesh.normals[:, 2].min() > 0.3
    overlap = 0.002 if make is winding else 0.02  # cells that another stretch covers only in part are all drawn
    assert sum(areas(mesh).sum() for mesh in meshes) == pytest.approx((x1 - x0) * (y1 - y0), rel=overlap)


def test_drawn_meshes_are_near_the_ground():
    surfaces = winding()
    road, verge, land = display_meshes(surfaces, 0.03)
    for mesh, tolerance in ((road, 0.03), (verge, 0.15), (land, 1.0)):
        np.testing.assert_allclose(surfaces.height(mesh.points[:, :2]), mesh.points[:, 2], atol=2e-3)
        middle = mesh.points[mesh.triangles].mean(axis=1)
        assert np.abs(surfaces.height(middle[:, :2]) - middle[:, 2]).max() < tolerance
    assert road.uv[:, 0].min() == 0.0
    assert road.uv[:, 0].max() == 1.0
    np.testing.assert_allclose(np.unique(road.uv[:, 1])[[0, -1]], [0.0, surfaces.centreline.length], atol=1e-9)
    # To the left of the road, u is 0.
    first = road.points[road.uv[:, 0] == 0.0]
    assert (surfaces.centreline.closest(first[:, :2])[1] > 3.5).all()


def test_land_meets_the_verge_at_shared_points():
    surfaces = winding()
    _, verge, land = display_meshes(surfaces, 0.03)
    rim = verge.points[np.abs(np.abs(verge.uv[:, 0]) - surfaces.strip.limit) < 1e-9]
    assert len(rim) > 100
    shared = {tuple(row) for row in np.round(land.points, 6).tolist()}
    assert all(tuple(row) in shared for row in np.round(rim, 6).tolist())


# ---- input -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"half_width": 0.0}, "half_width is 0; it must be greater than 0"),
        ({"verge": -1.0}, "verge is -1"),
        ({"bank": 1.0}, "bank is 1; it must be from 0 to 0.3"),
        ({"land": lambda xy: np.full(xy.shape[:-1], np.nan)}, "one finite number for each place"),
        ({"land": lambda xy: xy}, "one finite number for each place"),
    ],
)
def test_bad_input_is_named(change: dict, says: str):
    line = Centreline(np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]]), closed=False)
    settings = {"half_width": 4.0, "verge": 1.0, "land": rolling_land} | change
    with pytest.raises(InputError, match=says):
        RoadSurfaces(line, **settings)
