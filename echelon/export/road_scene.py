"""A road and what is around it, ready to be drawn: ground, paint, side streets, scenery, things on the road.

What lies on the ground (paint, side streets) or stands on it takes its height from the triangles that are drawn, not
from the smooth surface that wheels feel, from which they differ by up to the tolerance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.export.displayed_ground import DisplayedGround
from echelon.export.drawn_parts import DrawnPart
from echelon.export.scenery_assets import INDIVIDUAL_COLORS, obstacle, variant
from echelon.export.shapes import Mesh
from echelon.scenario.road import ObstacleSettings
from echelon.terrain.course import Course
from echelon.terrain.road_display import display_meshes
from echelon.terrain.roadside import place_roadside
from echelon.terrain.spline import Centreline
from echelon.terrain.triangulation import TriangleMesh
from echelon.warp_kernels.model import Vec3

TOLERANCE = 0.03  # [m] of the triangles of the road that are drawn
LAND_TOLERANCE = 0.5  # [m] of those of the land
PAINT_LIFT = 0.012  # [m] of paint above the road
STREET_LIFT = 0.03  # [m] of side streets above the land, which is drawn more coarsely
STREET_STEP = 1.0  # [m] along a side street from line to line, at the road
STREET_COLUMNS = 6  # of points across it
PAINT_STEPS = (2, 4, 8, 16)  # [m], a painted line is drawn in pieces as long as it is straight
PAINT_TOLERANCE = 0.006  # [m]

# Linear RGB.
ASPHALT: Vec3 = (0.085, 0.087, 0.092)
STREET: Vec3 = (0.105, 0.103, 0.100)
VERGE: Vec3 = (0.150, 0.190, 0.075)
GRASS: Vec3 = (0.115, 0.215, 0.058)
PAINT: Vec3 = (0.72, 0.72, 0.69)

_KINDS_OF_GROUND = {
    "road": ("asphalt", ASPHALT, True),
    "verge": ("verge", VERGE, True),
    "land": ("land", GRASS, False),
}


@dataclass(frozen=True)
class GroundPart:
    """Ground of one kind.

    Attributes:
        name: "asphalt", "verge", "land", "streets" or "paint".
        mesh: In the world [m].
        color: Linear RGB.
        uv: For each point how far across, and how far along [m], float32, shape [n, 2]; None of the land. Across is
            from the left edge, 0, to the right, 1; of the verge it is the offset from the centreline [m].
    """

    name: str
    mesh: Mesh
    color: Vec3
    uv: np.ndarray | None = None


@dataclass(frozen=True)
class PlacedKind:
    """All objects of a kind beside the road.

    Attributes:
        kind: One of `scenery_assets.VARIANTS`.
        positions: Of their feet [m], float64,              [n, 3]
        yaws: Which way their x looks [rad],                [n]
        scales: Along their own axes,                       [n, 3]
        colors: Linear RGB of each,                         [n, 3]
        variants: Which of the kind's variants each is,     int32 [n]
    """

    kind: str
    positions: np.ndarray
    yaws: np.ndarray
    scales: np.ndarray
    colors: np.ndarray
    variants: np.ndarray


@dataclass(frozen=True)
class PlacedObstacle:
    """Something that stands on the road.

    Attributes:
        name: Unique.
        kind: "car" or "barrier".
        parts: In its own frame [m].
        pose: x y z [m], quaternion (x, y, z, w), shape [7].
    """

    name: str
    kind: str
    parts: tuple[DrawnPart, ...]
    pose: np.ndarray


@dataclass(frozen=True)
class RoadScene:
    """A road and what is around it.

    Attributes:
        ground: Parts of the ground, paint last.
        placed: What stands beside the road.
        obstacles: What stands on it.
    """

    ground: tuple[GroundPart, ...]
    placed: tuple[PlacedKind, ...]
    obstacles: tuple[PlacedObstacle, ...]


def is_road(world: Mapping[str, Any]) -> bool:
    """Whether a recording's world is a road."""
    return world["ground"].get("shape") == "road"


def road_scene(world: Mapping[str, Any]) -> RoadScene:
    """The scene of a recording's world that `is_road`."""
    course = Course.from_dict(world["course"])
    surfaces = display_meshes(course.surfaces, TOLERANCE, LAND_TOLERANCE)
    ground = DisplayedGround(np.concatenate([mesh.points[mesh.triangles] for mesh in surfaces]))
    parts = [_part(surface) for surface in surfaces]
    streets = _streets(course, ground)
    if streets is not None:
        parts.append(streets)
    parts.append(_paint(course, ground))
    return RoadScene(tuple(parts), _placed(course), _obstacles(world.get("obstacles", ()), course.centreline, ground))


# ---- ground --------------------------------------------------------------------------------------------------------
def _part(surface: TriangleMesh) -> GroundPart:
    name, color, has_uv = _KINDS_OF_GROUND[surface.name]
    mesh = _mesh(surface.points, surface.normals, surface.triangles)
    return GroundPart(name, mesh, color, surface.uv.astype(np.float32) if has_uv else None)


def _streets(course: Course, ground: DisplayedGround) -> GroundPart | None:
    """Side streets, laid on the ground; they end where the road begins."""
    half = 0.5 * course.side_street_width
    across = half * np.linspace(1.0, -1.0, STREET_COLUMNS)
    strips = []
    for street in course.side_streets:
        line = _resampled(np.array(street, dtype=np.float64), STREET_STEP)
        # Finely where the road's edge cuts it off, coarsely elsewhere.
        _, beside = course.centreline.closest(line)
        kept = (np.abs(beside) < course.half_width + course.side_street_width) | (np.arange(len(line)) % 4 == 0)
        kept[-1] = True
        line = line[kept]
        along = np.gradient(line, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        left = np.column_stack([-along[:, 1], along[:, 0]])
        places = line[:, None] + across[:, None] * left[:, None]
        s, offset = course.centreline.closest(places)
        near = np.column_stack([places.reshape(-1, 2), course.centreline.position(s.reshape(-1))[:, 2]])
        heights = ground.heights(near).reshape(places.shape[:2]) + STREET_LIFT
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        on_road = np.abs(offset) < course.half_width - 0.15
        strips.append(_strip(np.dstack([places, heights]), length, on_road))
    strips = [strip for strip in strips if len(strip[2])]
    if not strips:
        return None
    return _joined_part("streets", strips, STREET)


def _paint(course: Course, ground: DisplayedGround) -> GroundPart:
    """Edge lines, centre dashes, start and finish."""
    line = course.centreline
    pieces = _PaintPieces(line)
    rows = np.concatenate(list(course.lines().values()))
    cuts = [pieces.between(s0, s1) for s0, s1 in rows[:, :2].tolist()]
    s = np.concatenate(cuts)
    owner = np.repeat(np.arange(len(rows)), [len(cut) for cut in cuts])
    offsets = np.sort(rows[owner, 2:], axis=1)[:, ::-1]
    middle = line.position(s)
    places = middle[:, None, :2] + offsets[..., None] * line.left(s)[:, None]
    near = np.column_stack([places.reshape(-1, 2), np.repeat(middle[:, 2], 2)])
    points = np.dstack([places, ground.heights(near).reshape(-1, 2) + PAINT_LIFT])
    return _joined_part("paint", [_strip(points[owner == row], cuts[row], None) for row in range(len(rows))], PAINT)


class _PaintPieces:
    """Where to cut painted lines so that every piece of them is as good as straight."""

    def __init__(self, line: Centreline) -> None:
        count = int(np.ceil(line.length))
        self._places = line.position(np.arange(count + max(PAINT_STEPS) + 1, dtype=np.float64))
        # For each metre the longest step that may begin there.
        self._steps = np.ones(count + 1, dtype=np.int64)
        for step in sorted(PAINT_STEPS):
            start, middle, end = (self._places[first : first + count + 1] for first in (0, step // 2, step))
            straight = np.linalg.norm(middle - 0.5 * (start + end), axis=1) < PAINT_TOLERANCE
            self._steps[straight] = step

    def between(self, s0: float, s1: float) -> np.ndarray:
        """Arc lengths from s0 to s1, both included [m]."""
        found = [s0]
        while found[-1] < s1 - 1e-6:
            found.append(min(found[-1] + float(self._steps[int(found[-1])]), s1))
        return np.array(found)


# ---- what stands there ---------------------------------------------------------------------------------------------
def _placed(course: Course) -> tuple[PlacedKind, ...]:
    found = []
    for kind, placement in place_roadside(course).items():
        if len(placement):
            palette = np.array(INDIVIDUAL_COLORS[kind])
            numbers = np.asarray(placement.colors)
            found.append(
                PlacedKind(
                    kind,
                    np.asarray(placement.positions, dtype=np.float64),
                    np.asarray(placement.yaws, dtype=np.float64),
                    np.asarray(placement.scales, dtype=np.float64),
                    palette[numbers % len(palette)],
                    variant(kind, numbers),
                )
            )
    return tuple(found)


def _obstacles(
    entries: Sequence[Mapping[str, Any]], line: Centreline, ground: DisplayedGround
) -> tuple[PlacedObstacle, ...]:
    """Parked cars and barriers; joggers are actors and move."""
    found = []
    for entry in entries:
        if entry["kind"] == "jogger":
            continue
        kind, s = str(entry["kind"]), float(entry["distance"])
        settings = ObstacleSettings(**entry)
        middle = line.position(s)
        place = middle + [*(float(entry["offset"]) * line.left(s)), 0.0]
        plane = ground.planes(place[None])[0]
        place[2] = (plane[3] - plane[:2] @ place[:2]) / plane[2]
        number = sum(other.kind == kind for other in found) + 1
        pose = np.concatenate([place, standing(line.tangent(s), plane[:3])])
        found.append(PlacedObstacle(f"{kind}_{number}", kind, obstacle(kind, *settings.size), pose))
    return tuple(found)


def standing(ahead: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Quaternion (x, y, z, w) of what looks ahead, as far as its up allows; neither need be of unit length."""
    z = up / np.linalg.norm(up)
    x = ahead - (ahead @ z) * z
    x /= np.linalg.norm(x)
    return Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z])).as_quat()


# ---- strips --------------------------------------------------------------------------------------------------------
Strip = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points [n, 3], uv [n, 2] and triangles [m, 3]."""


def _strip(places: np.ndarray, along: np.ndarray, hidden: np.ndarray | None) -> Strip:
    """A band: lines of points from left to right [lines, columns, 3], at distances [lines]; hidden cells left out.

    A cell is hidden where all its corners are.
    """
    lines, columns = places.shape[:2]
    number = np.arange(lines * columns).reshape(lines, columns)
    left, right = number[:-1, :-1], number[:-1, 1:]
    left_on, right_on = number[1:, :-1], number[1:, 1:]
    cells = np.stack([left, right, right_on, left_on], axis=-1).reshape(-1, 4)
    if hidden is not None:
        cells = cells[~hidden.reshape(-1)[cells].all(axis=1)]
    uv = np.dstack(np.broadcast_arrays(np.linspace(0.0, 1.0, columns)[None], along[:, None]))
    return places.reshape(-1, 3), uv.reshape(-1, 2), np.concatenate([cells[:, :3], cells[:, [0, 2, 3]]])


def _joined_part(name: str, strips: Sequence[Strip], color: Vec3) -> GroundPart:
    starts = np.cumsum([0] + [len(points) for points, _, _ in strips])
    points = np.concatenate([points for points, _, _ in strips])
    triangles = np.concatenate([part + start for (_, _, part), start in zip(strips, starts, strict=False)])
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    points, uv = points[used], np.concatenate([uv for _, uv, _ in strips])[used]
    return GroundPart(name, _mesh(points, _normals(points, triangles), triangles), color, uv.astype(np.float32))


def _normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals at points: those of the triangles there, weighted by area, shape [n, 3]."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _mesh(points: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> Mesh:
    return Mesh(
        points=np.ascontiguousarray(points, dtype=np.float32),
        normals=np.ascontiguousarray(normals, dtype=np.float32),
        face_vertex_counts=np.full(len(triangles), 3, dtype=np.int32),
        face_vertex_indices=np.ascontiguousarray(triangles, dtype=np.int32).reshape(-1),
    )


def _resampled(line: np.ndarray, step: float) -> np.ndarray:
    """A polyline [n, 2] in steps of about a length [m], its corners kept."""
    pieces = [line[:1]]
    for start, end in pairwise(line):
        count = max(int(np.ceil(np.linalg.norm(end - start) / step)), 1)
        pieces.append(start + np.arange(1, count + 1)[:, None] / count * (end - start))
    return np.concatenate(pieces)
