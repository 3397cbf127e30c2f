"""A road and its land as flat triangles to be drawn: few of them, and none through another.

Asphalt and verge are cut across at arc lengths chosen by how the road bends, in plan and in profile. The land is a
Delaunay triangulation of two kinds of points: the outer ends of those cuts, which it shares with the verge, and points
of its own, closer where it is rough and near the road. What lies under the road is taken out.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from echelon.terrain.road import RoadSurfaces
from echelon.terrain.triangulation import TriangleMesh

LONGEST_CUT = 32.0  # [m] between cuts across the road
SHORTEST_CUT = 0.5  # [m]
LARGEST_SQUARE = 128.0  # [m] between points of the land
SMALLEST_SQUARE = 16.0  # [m]
SQUARE_GROWTH = 0.6  # of the distance from the road that a square of land may be wide


def display_meshes(
    surfaces: RoadSurfaces, tolerance: float = 0.08, land_tolerance: float = 0.5
) -> tuple[TriangleMesh, ...]:
    """Flat triangles to be drawn: "road", "verge" and "land", which meet and do not overlap.

    Args:
        surfaces: Of a road and its land.
        tolerance: Greatest distance of the asphalt from the surface, and of the lines along the verge [m]; across,
            verge and shoulder are each drawn flat.
        land_tolerance: Of the land, which is coarser the farther it is from the road [m].

    Returns:
        The asphalt, with uv = (0 at the left edge to 1 at the right, arc length [m]); the ground beside it, with
        uv = (offset [m], arc length [m]); and the land, with uv = (x, y) [m].
    """
    if not min(tolerance, land_tolerance) > 0.0:
        raise ValueError(f"tolerances are {tolerance} and {land_tolerance}; they must be greater than 0")
    cuts = _cuts(surfaces, tolerance)
    return _road(surfaces, cuts), _verge(surfaces, cuts), _land(surfaces, cuts, land_tolerance)


def _cuts(surfaces: RoadSurfaces, tolerance: float) -> np.ndarray:
    """Arc lengths between which the road's edges are straight to within the tolerance."""
    strip = surfaces.strip
    count = max(8, int(np.ceil((strip.end - strip.start) / LONGEST_CUT)))
    cuts = np.linspace(strip.start, strip.end, count + 1)
    while True:
        middles = 0.5 * (cuts[:-1] + cuts[1:])
        ends, between = _lines_along(surfaces, cuts), _lines_along(surfaces, middles)
        error = np.linalg.norm(between - 0.5 * (ends[:, :-1] + ends[:, 1:]), axis=-1).max(axis=0)
        halve = (error > tolerance) & (np.diff(cuts) > 2.0 * SHORTEST_CUT)
        if not halve.any():
            return cuts
        cuts = np.sort(np.concatenate([cuts, middles[halve]]))


def _lines_along(surfaces: RoadSurfaces, s: np.ndarray) -> np.ndarray:
    """The edges of the strip, those of the asphalt, and the centreline, shape [5, len(s), 3]."""
    return surfaces.road_point(s, np.concatenate([_offsets(surfaces, s)[[0, 2, 3, 5]], np.zeros((1, len(s)))]))


def _offsets(surfaces: RoadSurfaces, s: np.ndarray) -> np.ndarray:
    """Of the strip's edge, the level's and the asphalt's, from left to right [m], shape [6, len(s)]."""
    strip = surfaces.strip
    (left, right), (level_left, level_right) = strip.limits(s), strip.levels(s)
    paved_left, paved_right = (np.minimum(strip.half_width, level) for level in (level_left, level_right))
    return np.stack([left, level_left, paved_left, -paved_right, -level_right, -right])


def _road(surfaces: RoadSurfaces, s: np.ndarray) -> TriangleMesh:
    offsets = _offsets(surfaces, s)[2:4]
    across = np.broadcast_to(np.array([0.0, 1.0])[:, None], offsets.shape)
    return _ribbon(surfaces, "road", s, offsets, across, paved=True)


def _verge(surfaces: RoadSurfaces, s: np.ndarray) -> TriangleMesh:
    offsets = _offsets(surfaces, s)
    left, right = (_ribbon(surfaces, "verge", s, part, part, paved=False) for part in (offsets[:3], offsets[3:]))
    return TriangleMesh(
        "verge",
        np.concatenate([left.points, right.points]),
        np.concatenate([left.normals, right.normals]),
        np.concatenate([left.uv, right.uv]),
        np.concatenate([left.triangles, right.triangles + np.int32(len(left.points))]),
    )


def _ribbon(
    surfaces: RoadSurfaces, name: str, s: np.ndarray, offsets: np.ndarray, across: np.ndarray, *, paved: bool
) -> TriangleMesh:
    """Cells between lines along the road, from left to right, without those that another stretch covers."""
    v = np.broadcast_to(s, offsets.shape)
    u = surfaces.parameter_at(offsets, v)
    points, normals = surfaces.road.point(u, v), surfaces.road.normal(u, v)
    corner = np.arange(offsets.size, dtype=np.int32).reshape(offsets.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    cells = np.stack([a, b, c, a, c, d], axis=-1)
    # A cell as wide as nothing is no cell: where asphalt reaches as far as the level, there is no verge between.
    wide = (offsets[:-1] - offsets[1:])[:, :-1] + (offsets[:-1] - offsets[1:])[:, 1:] > 1e-6
    wide &= ~_covered(surfaces, s, offsets, paved=paved)
    flat = offsets.size
    uv = np.stack([across.reshape(flat), v.reshape(flat)], axis=1)
    return TriangleMesh(name, points.reshape(flat, 3), normals.reshape(flat, 3), uv, cells[wide].reshape(-1, 3))


def _covered(surfaces: RoadSurfaces, s: np.ndarray, offsets: np.ndarray, *, paved: bool) -> np.ndarray:
    """Which cells another stretch covers: its asphalt covers any verge, and what comes first covers its like."""
    strip = surfaces.strip
    middle_s = 0.5 * (s[:-1] + s[1:])
    middle_offsets = 0.25 * (offsets[:-1, :-1] + offsets[1:, :-1] + offsets[:-1, 1:] + offsets[1:, 1:])
    covered = np.zeros(middle_offsets.shape, dtype=bool)
    meeting = np.flatnonzero(strip.meets(middle_s))
    if not len(meeting):
        return covered
    places = surfaces.road_point(middle_s[meeting], middle_offsets[:, meeting])[..., :2]
    feet = strip.feet(places.reshape(-1, 2))
    own = np.broadcast_to(middle_s[meeting], places.shape[:2]).ravel()[feet.place]
    other = np.abs(strip.centreline.difference(feet.s, own)) > strip.limit
    on_asphalt = np.abs(feet.offset) < strip.half_width
    over = other & ((feet.s < own) & on_asphalt if paved else (feet.s < own) | on_asphalt)
    hidden = np.zeros(places.shape[0] * places.shape[1], dtype=bool)
    hidden[feet.place[over]] = True
    covered[:, meeting] = hidden.reshape(places.shape[:2])
    return covered


# ---- the land --------------------------------------------------------------------------------------------------------
def _land(surfaces: RoadSurfaces, s: np.ndarray, tolerance: float) -> TriangleMesh:
    rim = surfaces.road_point(s, _offsets(surfaces, s)[[0, 5]])
    if surfaces.centreline.closed:
        rim = rim[:, :-1]
    rim = rim.reshape(-1, 3)
    feet = surfaces.strip.feet(rim[:, :2])
    left, right = surfaces.strip.limits(feet.s)
    within = np.minimum(left - feet.offset, right + feet.offset) > 0.05  # in the strip of another stretch
    rim = np.delete(rim, np.unique(feet.place[within]), axis=0)
    own = _land_points(surfaces, tolerance)
    flat = np.concatenate([rim[:, :2], own])
    triangles = Delaunay(flat).simplices
    middles = flat[triangles].mean(axis=1)
    under = np.unique(surfaces.strip.feet(middles).place)
    triangles = np.delete(triangles, under, axis=0).astype(np.int32)
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where(turn[:, None] > 0.0, triangles, triangles[:, ::-1])[np.abs(turn) > 1e-6]
    x, y = np.clip(flat[:, 0], *surfaces.land.range_u), np.clip(flat[:, 1], *surfaces.land.range_v)
    heights = np.concatenate([rim[:, 2], surfaces.land.point(x, y)[len(rim) :, 2]])
    return TriangleMesh("land", np.column_stack([flat, heights]), surfaces.land.normal(x, y), flat.copy(), triangles)


def _land_points(surfaces: RoadSurfaces, tolerance: float) -> np.ndarray:
    """Corners of squares of land that are small where it is rough or near the road, off the strip, shape [n, 2]."""
    low = np.array([surfaces.land.range_u[0], surfaces.land.range_v[0]])
    high = np.array([surfaces.land.range_u[1], surfaces.land.range_v[1]])
    counts = np.ceil((high - low) / LARGEST_SQUARE).astype(np.int64)
    size = (high - low) / counts
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    points = [
        low + size * cells,
        low + size * (cells + 1),
        low + size * (cells + [1, 0]),
        low + size * (cells + [0, 1]),
    ]
    corner = low + size * cells
    while len(corner) and size.max() >= 2.0 * SMALLEST_SQUARE:
        middle = corner + 0.5 * size
        heights = surfaces.land_height(corner[:, None] + size * np.array([[0, 0], [1, 0], [0, 1], [1, 1]]))
        error = np.abs(surfaces.land_height(middle) - heights.mean(axis=1))
        away = np.abs(surfaces.centreline.closest(middle)[1]) - surfaces.strip.limit
        split = (error > tolerance) | (size.max() > np.maximum(SQUARE_GROWTH * away, SMALLEST_SQUARE))
        size = 0.5 * size
        quarters = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        corner = (corner[split][:, None] + size * quarters).reshape(-1, 2)
        parents = corner.reshape(-1, 4, 2)[:, 0]
        nine = np.stack(np.meshgrid([0, 1, 2], [0, 1, 2], indexing="ij"), axis=-1).reshape(-1, 2)
        points.append((parents[:, None] + size * nine).reshape(-1, 2))
    unit = size / 4.0
    keys = np.unique(np.round((np.concatenate(points) - low) / unit).astype(np.int64), axis=0)
    places = np.clip(low + keys * unit, low, high)
    distance = np.abs(surfaces.centreline.closest(places)[1])
    return places[distance > surfaces.strip.limit + 0.5 * SMALLEST_SQUARE]
