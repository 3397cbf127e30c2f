"""Polygon meshes of what a recording shows: the shapes of links, the ground, fences, the collie on its bicycle.

Every mesh has one normal a point; edges that are to look sharp have their points twice. Faces wind counter-clockwise
seen from outside. Poles of ellipsoids and capsules are triangles, the ends of cylinders one polygon each, the rest
quadrilaterals: few faces, round silhouettes. A torus is quadrilaterals all round. A mesh of a body's own is triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from echelon.export.smooth_normals import smoothed
from echelon.warp_kernels.model import Vec3, Visual, VisualShape

SEGMENTS_ELLIPSOID = 14  # around; with 8 bands from pole to pole 196 triangles
BANDS_ELLIPSOID = 8
SEGMENTS_CAPSULE = 10  # around; with 3 bands a cap 120 triangles
BANDS_CAP = 3
SEGMENTS_CYLINDER = 16  # around; 60 triangles
SEGMENTS_TORUS = 32  # around the ring; with 6 around its section 384 triangles
SEGMENTS_SECTION = 6
SEGMENTS_HALF_CIRCLE = 48  # of the oval's outline

POST_SPACING = 2.0  # [m] between fence posts, at most
POST_HALF_WIDTH = 0.05  # [m]
RAIL_HALF_HEIGHT = 0.05  # [m]
PLATFORM_THICKNESS = 0.25  # [m]
RAIL_HALF_DEPTH = 0.02  # [m]
RAIL_HEIGHTS = (0.3, 0.62, 0.94)  # as parts of the fence's height

WHEELBASE = 1.0  # [m]
WHEEL_RADIUS = 0.34  # [m]

BLACK: Vec3 = (0.012, 0.012, 0.014)
WHITE: Vec3 = (0.85, 0.84, 0.80)
TAN: Vec3 = (0.30, 0.13, 0.05)
RUBBER: Vec3 = (0.02, 0.02, 0.02)
STEEL: Vec3 = (0.45, 0.46, 0.48)
FRAME_RED: Vec3 = (0.50, 0.03, 0.02)


@dataclass(frozen=True)
class Mesh:
    """A polygon mesh.

    Attributes:
        points: Vertices [m], float32, shape [n, 3].
        normals: Unit normals, one a vertex, float32, shape [n, 3].
        face_vertex_counts: Corners of each face, int32, shape [faces].
        face_vertex_indices: Vertices of the corners, face after face, int32, shape [corners].
    """

    points: np.ndarray
    normals: np.ndarray
    face_vertex_counts: np.ndarray
    face_vertex_indices: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        """Least and greatest corner of the axis-aligned box around the points [m], float32, shape [2, 3]."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    @property
    def triangles(self) -> np.ndarray:
        """The faces cut into fans of triangles, int32, shape [triangles, 3]; all faces here are convex."""
        first_corner = np.cumsum(self.face_vertex_counts) - self.face_vertex_counts
        fan_count = self.face_vertex_counts - 2
        face = np.repeat(np.arange(len(fan_count)), fan_count)
        step = np.arange(len(face)) - np.repeat(np.cumsum(fan_count) - fan_count, fan_count)
        start = first_corner[face]
        corners = np.stack([start, start + step + 1, start + step + 2], axis=1)
        return self.face_vertex_indices[corners].astype(np.int32)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several, in order; raises ValueError when there is none."""
    if not meshes:
        raise ValueError("joined() needs at least one mesh, found none")
    offsets = np.cumsum([0] + [len(mesh.points) for mesh in meshes[:-1]])
    return Mesh(
        points=np.concatenate([mesh.points for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        face_vertex_counts=np.concatenate([mesh.face_vertex_counts for mesh in meshes]),
        face_vertex_indices=np.concatenate(
            [mesh.face_vertex_indices + offset for mesh, offset in zip(meshes, offsets, strict=True)]
        ).astype(np.int32),
    )


def visual_mesh(visual: Visual) -> Mesh:
    """Mesh of a visual in the frame of its link: the visual's position and orientation are applied [m]."""
    unplaced = _faceted(visual) if visual.shape == "mesh" else _shape_mesh(visual.shape, visual.size)
    rotation = rotation_matrix(visual.orientation)
    return Mesh(
        points=(unplaced.points @ rotation.T + np.asarray(visual.position)).astype(np.float32),
        normals=(unplaced.normals @ rotation.T).astype(np.float32),
        face_vertex_counts=unplaced.face_vertex_counts,
        face_vertex_indices=unplaced.face_vertex_indices,
    )


def rotation_matrix(quaternion: Sequence[float]) -> np.ndarray:
    """Rotation matrix of a quaternion (x, y, z, w) of any length but zero, float64, shape [3, 3]."""
    x, y, z, w = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def box_between(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """A box along the axes from its least corner to its greatest [m]."""
    half = 0.5 * (np.asarray(high, dtype=float) - np.asarray(low, dtype=float))
    middle = 0.5 * (np.asarray(high, dtype=float) + np.asarray(low, dtype=float))
    return _boxes(middle[None], half[None], np.zeros(1))


def capsule_between(start: Vec3, end: Vec3, radius: float, color: Vec3 | None = None) -> Visual:
    """A capsule whose caps are centred on two points [m] that must differ."""
    first, second = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(second - first))
    if not length > 0.0:
        raise ValueError(f"capsule_between() needs two different points, found {start} twice")
    middle = 0.5 * (first + second)
    return Visual(
        shape="capsule",
        size=(radius, 0.5 * length, 0.0),
        position=(float(middle[0]), float(middle[1]), float(middle[2])),
        orientation=_quaternion_from_z((second - first) / length),
        color=color,
    )


# ---- the world ---------------------------------------------------------------------------------------------------
def oval_mesh(half_length: float, half_width: float) -> Mesh:
    """A flat stadium on z = 0: straight sides along x, half circles at both ends, centred on the origin.

    Args:
        half_length: From the centre to either end, half circle included [m]; taken as half_width when shorter.
        half_width: From the centre to either straight side, the half circles' radius [m].
    """
    return _flat_disc(oval_outline(half_length, half_width))


def oval_outline(half_length: float, half_width: float) -> np.ndarray:
    """Outline of the stadium of `oval_mesh`, counter-clockwise, not repeated at its end [m], shape [n, 2]."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS_HALF_CIRCLE + 1)
    half_circle = half_width * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    straight = max(half_length - half_width, 0.0)
    front = half_circle + np.array([straight, 0.0])
    return np.concatenate([front, -front]) if straight > 0.0 else np.concatenate([front[:-1], -front[:-1]])


def rectangle_mesh(half_length: float, half_width: float) -> Mesh:
    """A flat rectangle on z = 0, centred on the origin, half_length along x and half_width along y [m]."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [half_length, half_width]
    return _flat_disc(corners)


def wall_mesh(points: Sequence[Sequence[float]] | np.ndarray, closed: bool, height: float) -> Mesh:
    """A thin solid wall along a polyline on z = 0, as high as its fence: what things bump into; see `fence_mesh`."""
    starts, spans, lengths, headings = _straights(points, closed)
    half_sizes = np.column_stack(
        [0.5 * lengths, np.full(len(lengths), RAIL_HALF_DEPTH), np.full(len(lengths), 0.5 * height)]
    )
    centers = np.column_stack([starts + 0.5 * spans, np.full(len(lengths), 0.5 * height)])
    return _boxes(centers, half_sizes, headings)


def platform_mesh(platform: Mapping[str, Any]) -> Mesh:
    """A platform above water with the pillar that carries it, from its height, heading, edge, length and width [m]."""
    height, length, width = (float(platform[key]) for key in ("height", "length", "width"))
    heading = float(platform["heading"])
    inward = np.array([np.cos(heading), np.sin(heading), 0.0])
    edge = np.array([*platform["edge"], 0.0], dtype=float)
    up = np.array([0.0, 0.0, 1.0])
    thickness = min(PLATFORM_THICKNESS, height)
    slab = edge + 0.5 * length * inward + (height - 0.5 * thickness) * up
    pillar = edge + 0.75 * length * inward + 0.5 * (height - thickness) * up
    half_sizes = 0.5 * np.array([[length, width, thickness], [0.25 * length, 0.6 * width, height - thickness]])
    return _boxes(np.stack([slab, pillar]), half_sizes, np.full(2, heading))


def ground_mesh(ground: Mapping[str, object], margin: float = 0.0) -> Mesh:
    """Mesh of a recording's ground: ``oval``, ``mat`` or ``plane``, wider by a margin all round [m]."""
    if ground.get("shape") == "oval":
        return oval_mesh(_length(ground, "half_length") + margin, _length(ground, "half_width") + margin)
    if ground.get("shape") == "mat":
        return rectangle_mesh(_length(ground, "half_length") + margin, _length(ground, "half_width") + margin)
    half_size = _length(ground, "half_size") + margin
    return rectangle_mesh(half_size, half_size)


def fence_mesh(points: Sequence[Sequence[float]] | np.ndarray, closed: bool, height: float) -> Mesh:
    """A fence of posts and three rails along a polyline on z = 0.

    Args:
        points: Corners [m], shape [n, 2], n at least 2.
        closed: Whether the last corner is joined to the first.
        height: Of the posts [m].
    """
    starts, spans, lengths, headings = _straights(points, closed)
    centers, half_sizes, angles = [], [], []
    for part in RAIL_HEIGHTS:
        middle = starts + 0.5 * spans
        centers.append(np.column_stack([middle, np.full(len(lengths), part * height)]))
        half_sizes.append(
            np.column_stack(
                [0.5 * lengths, np.full(len(lengths), RAIL_HALF_DEPTH), np.full(len(lengths), RAIL_HALF_HEIGHT)]
            )
        )
        angles.append(headings)
    posts, post_headings = _post_places(starts, spans, lengths, headings, closed)
    centers.append(np.column_stack([posts, np.full(len(posts), 0.5 * height)]))
    half_sizes.append(np.tile([POST_HALF_WIDTH, POST_HALF_WIDTH, 0.5 * height], (len(posts), 1)))
    angles.append(post_headings)
    return _boxes(np.concatenate(centers), np.concatenate(half_sizes), np.concatenate(angles))


def columns_mesh(columns: Sequence[Mapping[str, Any]]) -> Mesh:
    """Round columns that stand on z = 0, as a recording's world lists them: center, radius and height [m]."""
    return joined(
        [
            visual_mesh(
                Visual(
                    "cylinder",
                    (float(column["radius"]), 0.5 * float(column["height"]), 0.0),
                    position=(float(column["center"][0]), float(column["center"][1]), 0.5 * float(column["height"])),
                )
            )
            for column in columns
        ]
    )


@lru_cache(maxsize=1)
def bicycle_visuals() -> tuple[Visual, ...]:
    """The collie: a bicycle and its rider in a border collie's black, white and tan.

    The frame is the actor's: origin on the ground halfway between the wheels, x forward, y left, z up [m].
    """
    rear, front = -0.5 * WHEELBASE, 0.5 * WHEELBASE
    hub = WHEEL_RADIUS
    crank, saddle, head = (-0.08, 0.0, 0.28), (-0.22, 0.0, 0.92), (0.34, 0.0, 0.86)
    hip, shoulder, bar = (-0.18, 0.0, 1.00), (0.16, 0.0, 1.42), (0.42, 0.0, 1.02)
    parts = [
        _wheel(rear),
        _wheel(front),
        _wheel(rear, radius=0.9 * WHEEL_RADIUS, half_width=0.024, color=STEEL),
        _wheel(front, radius=0.9 * WHEEL_RADIUS, half_width=0.024, color=STEEL),
        capsule_between((rear, 0.0, hub), crank, 0.018, FRAME_RED),
        capsule_between((rear, 0.0, hub), saddle, 0.014, FRAME_RED),
        capsule_between(crank, saddle, 0.02, FRAME_RED),
        capsule_between(crank, head, 0.022, FRAME_RED),
        capsule_between((-0.2, 0.0, 0.84), head, 0.02, FRAME_RED),
        capsule_between((front, 0.0, hub), head, 0.018, FRAME_RED),
        capsule_between(head, bar, 0.016, STEEL),
        capsule_between((bar[0], -0.26, bar[2]), (bar[0], 0.26, bar[2]), 0.016, STEEL),
        Visual("ellipsoid", (0.15, 0.08, 0.035), position=(-0.22, 0.0, 0.95), color=RUBBER),
        capsule_between(hip, shoulder, 0.145, BLACK),
        Visual("ellipsoid", (0.13, 0.12, 0.16), position=(0.17, 0.0, 1.33), color=WHITE),
        Visual("ellipsoid", (0.14, 0.115, 0.125), position=(0.27, 0.0, 1.66), color=BLACK),
        Visual("ellipsoid", (0.125, 0.03, 0.126), position=(0.29, 0.0, 1.665), color=WHITE),
        Visual("ellipsoid", (0.12, 0.055, 0.055), position=(0.40, 0.0, 1.61), color=WHITE),
        Visual("ellipsoid", (0.026, 0.03, 0.024), position=(0.515, 0.0, 1.625), color=RUBBER),
        capsule_between((0.20, 0.0, 1.46), (0.24, 0.0, 1.58), 0.075, WHITE),
        capsule_between((-0.26, 0.0, 1.02), (-0.56, 0.0, 1.18), 0.05, BLACK),
        capsule_between((-0.56, 0.0, 1.18), (-0.72, 0.0, 1.34), 0.04, WHITE),
    ]
    for side, pedal_x, pedal_z in ((1.0, 0.08, 0.26), (-1.0, -0.24, 0.30)):
        knee = (0.22, 0.1 * side, 0.68 if side > 0.0 else 0.78)
        pedal = (pedal_x, 0.1 * side, pedal_z)
        parts += [
            capsule_between((hip[0], 0.09 * side, hip[2]), knee, 0.075, BLACK),
            capsule_between(knee, pedal, 0.05, TAN),
            Visual("ellipsoid", (0.12, 0.045, 0.04), position=(pedal[0] + 0.05, pedal[1], pedal[2]), color=WHITE),
            capsule_between((shoulder[0], 0.17 * side, shoulder[2]), (0.30, 0.24 * side, 1.2), 0.05, BLACK),
            capsule_between((0.30, 0.24 * side, 1.2), (bar[0], 0.22 * side, bar[2]), 0.042, WHITE),
            capsule_between((0.22, 0.07 * side, 1.76), (0.19, 0.12 * side, 1.84), 0.035, BLACK),
        ]
    return tuple(parts)


def _wheel(x: float, radius: float = WHEEL_RADIUS, half_width: float = 0.02, color: Vec3 = RUBBER) -> Visual:
    """A disc in the bicycle's plane, standing on the ground at x [m]."""
    turned = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    return Visual("cylinder", (radius, half_width, 0.0), (x, 0.0, WHEEL_RADIUS), turned, color)


def _faceted(visual: Visual) -> Mesh:
    return _mesh(*smoothed(np.asarray(visual.points) * visual.size, np.asarray(visual.triangles)))


# ---- shapes about their own centre -------------------------------------------------------------------------------
def _shape_mesh(shape: VisualShape, size: Vec3) -> Mesh:
    builders: dict[VisualShape, Callable[[Vec3], Mesh]] = {
        "ellipsoid": _ellipsoid,
        "capsule": _capsule,
        "cylinder": _cylinder,
        "box": _box,
        "torus": _torus,
    }
    return builders[shape](size)


def _ellipsoid(size: Vec3) -> Mesh:
    polar = np.linspace(0.5 * np.pi, -0.5 * np.pi, BANDS_ELLIPSOID + 1)
    unit, counts, indices = _revolved(np.cos(polar), np.sin(polar), SEGMENTS_ELLIPSOID)
    semi_axes = np.asarray(size)
    normals = unit / semi_axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return _mesh(unit * semi_axes, normals, counts, indices)


def _capsule(size: Vec3) -> Mesh:
    radius, half_length, _ = size
    upper = np.linspace(0.5 * np.pi, 0.0, BANDS_CAP + 1)
    polar = np.concatenate([upper, -upper[::-1]])
    normals, counts, indices = _revolved(np.cos(polar), np.sin(polar), SEGMENTS_CAPSULE)
    lift = np.where(np.arange(len(normals)) < 1 + BANDS_CAP * SEGMENTS_CAPSULE, half_length, -half_length)
    points = radius * normals
    points[:, 2] += lift
    return _mesh(points, normals, counts, indices)


def _cylinder(size: Vec3) -> Mesh:
    radius, half_length, _ = size
    n = SEGMENTS_CYLINDER
    angle = 2.0 * np.pi * np.arange(n) / n
    outward = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    up = np.array([0.0, 0.0, 1.0])
    top, bottom = radius * outward + half_length * up, radius * outward - half_length * up
    points = np.concatenate([top, bottom, top, bottom])
    normals = np.concatenate([outward, outward, np.tile(up, (n, 1)), np.tile(-up, (n, 1))])
    here, after = np.arange(n), (np.arange(n) + 1) % n
    sides = np.column_stack([here, n + here, n + after, after]).reshape(-1)
    indices = np.concatenate([sides, 2 * n + here, (3 * n + here)[::-1]])
    return _mesh(points, normals, np.array([4] * n + [n, n]), indices)


def _torus(size: Vec3) -> Mesh:
    ring, section, _ = size
    n, m = SEGMENTS_TORUS, SEGMENTS_SECTION
    around = (2.0 * np.pi * np.arange(n) / n)[:, None]
    across = (2.0 * np.pi * np.arange(m) / m)[None, :]
    outward = np.broadcast_to(np.cos(across), (n, m))
    normals = np.stack(
        [outward * np.cos(around), outward * np.sin(around), np.broadcast_to(np.sin(across), (n, m))], axis=-1
    )
    centers = ring * np.stack([np.cos(around), np.sin(around), np.zeros((n, 1))], axis=-1)
    here = (m * np.arange(n)[:, None] + np.arange(m)).reshape(-1)
    ahead = np.roll(here.reshape(n, m), -1, axis=0).reshape(-1)
    above, both = (np.roll(row.reshape(n, m), -1, axis=1).reshape(-1) for row in (here, ahead))
    faces = np.column_stack([here, ahead, both, above]).reshape(-1)
    return _mesh((centers + section * normals).reshape(-1, 3), normals.reshape(-1, 3), np.full(n * m, 4), faces)


def _box(size: Vec3) -> Mesh:
    return _boxes(np.zeros((1, 3)), np.asarray(size, dtype=float).reshape(1, 3), np.zeros(1))


def _boxes(centers: np.ndarray, half_sizes: np.ndarray, headings: np.ndarray) -> Mesh:
    """Boxes turned about z: centres [m], half sizes [m], headings [rad], shapes [n, 3], [n, 3], [n]."""
    corner_signs, face_normals = [], []
    for axis in range(3):
        for side in (1.0, -1.0):
            normal = np.zeros(3)
            normal[axis] = side
            first, second = np.roll(np.eye(3), axis + 1, axis=1)[[0, 1]]
            # Counter-clockwise seen from outside: first x second is +axis.
            turn = ((-1, -1), (1, -1), (1, 1), (-1, 1)) if side > 0.0 else ((-1, -1), (-1, 1), (1, 1), (1, -1))
            corner_signs += [normal + a * first + b * second for a, b in turn]
            face_normals += [normal] * 4
    local = np.asarray(corner_signs)[None] * half_sizes[:, None]
    normal_rows = np.tile(np.asarray(face_normals), (len(centers), 1, 1))
    points = _turned(local, headings) + centers[:, None]
    normals = _turned(normal_rows, headings)
    return _mesh(
        points.reshape(-1, 3),
        normals.reshape(-1, 3),
        np.full(6 * len(centers), 4),
        np.arange(24 * len(centers)),
    )


def _turned(vectors: np.ndarray, headings: np.ndarray) -> np.ndarray:
    """Vectors [n, m, 3] turned about z by headings [n] in rad."""
    cos, sin = np.cos(headings)[:, None], np.sin(headings)[:, None]
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def _revolved(radii: np.ndarray, heights: np.ndarray, segments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, counts and indices of a profile from the upper pole to the lower, turned about z."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = [
        np.column_stack([radius * around, np.full(segments, height)])
        for radius, height in zip(radii[1:-1], heights[1:-1], strict=True)
    ]
    points = np.concatenate([[[0.0, 0.0, heights[0]]], *rows, [[0.0, 0.0, heights[-1]]]])
    here, after = np.arange(segments), (np.arange(segments) + 1) % segments
    last = len(points) - 1
    upper_pole = np.column_stack([np.zeros(segments, int), 1 + here, 1 + after])
    bands = [
        np.column_stack([row + here, row + segments + here, row + segments + after, row + after])
        for row in range(1, last - segments, segments)
    ]
    final = last - segments
    lower_pole = np.column_stack([final + here, np.full(segments, last), final + after])
    counts = np.concatenate([np.full(segments, 3), np.full(segments * len(bands), 4), np.full(segments, 3)])
    indices = np.concatenate([upper_pole.reshape(-1), *[band.reshape(-1) for band in bands], lower_pole.reshape(-1)])
    return points, counts, indices


def _flat_disc(outline: np.ndarray) -> Mesh:
    """A fan from the origin to a counter-clockwise outline [n, 2] on z = 0."""
    n = len(outline)
    points = np.zeros((n + 1, 3))
    points[1:, :2] = outline
    here = np.arange(n)
    indices = np.column_stack([np.zeros(n, int), 1 + here, 1 + (here + 1) % n]).reshape(-1)
    return _mesh(points, np.tile([0.0, 0.0, 1.0], (n + 1, 1)), np.full(n, 3), indices)


def _straights(
    points: Sequence[Sequence[float]] | np.ndarray, closed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Straight pieces of a polyline: starts [n, 2], spans [n, 2], lengths [n] and headings [n]; no corner unbent."""
    corners = np.asarray(points, dtype=float).reshape(-1, 2)
    apart = np.linalg.norm(np.diff(corners, axis=0), axis=1) > 1e-6
    corners = corners[np.concatenate([[True], apart])]
    if closed and np.linalg.norm(corners[-1] - corners[0]) <= 1e-6:
        corners = corners[:-1]
    if len(corners) < 2:
        raise ValueError(f"a fence needs two different points, found {len(corners)}")
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    across = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    bent = np.abs(across) > 1e-9 * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    bent |= (before * after).sum(axis=1) < 0.0
    if not closed:
        bent[[0, -1]] = True
    corners = corners[bent]
    starts, ends = (corners, np.roll(corners, -1, axis=0)) if closed else (corners[:-1], corners[1:])
    spans = ends - starts
    return starts, spans, np.linalg.norm(spans, axis=1), np.arctan2(spans[:, 1], spans[:, 0])


def _post_places(
    starts: np.ndarray, spans: np.ndarray, lengths: np.ndarray, headings: np.ndarray, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Places [n, 2] and headings [n] of posts evenly along the whole polyline, and at its sharp corners."""
    before = np.concatenate([[0.0], np.cumsum(lengths)])
    total = float(before[-1])
    bends = np.abs((np.diff(headings) + np.pi) % (2.0 * np.pi) - np.pi)
    fixed = np.concatenate([[0.0], before[1:-1][bends > np.radians(30.0)], [total]])
    along: list[np.ndarray] = []
    for begin, end in pairwise(fixed):
        count = max(int(np.ceil((end - begin) / POST_SPACING)), 1)
        along.append(begin + (end - begin) * np.arange(count) / count)
    if not closed:
        along.append(np.array([total]))
    distance = np.concatenate(along)
    segment = np.clip(np.searchsorted(before, distance, side="right") - 1, 0, len(lengths) - 1)
    part = (distance - before[segment]) / lengths[segment]
    return starts[segment] + part[:, None] * spans[segment], headings[segment]


def _quaternion_from_z(direction: np.ndarray) -> tuple[float, float, float, float]:
    """Shortest rotation from +z to a unit direction, (x, y, z, w)."""
    if direction[2] < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0, 0.0)
    quaternion = np.array([-direction[1], direction[0], 0.0, 1.0 + direction[2]])
    quaternion /= np.linalg.norm(quaternion)
    return (float(quaternion[0]), float(quaternion[1]), 0.0, float(quaternion[3]))


def _length(ground: Mapping[str, object], key: str) -> float:
    value = ground.get(key)
    if not isinstance(value, float | int):
        raise ValueError(f"ground: {key} is {value!r}, not a length in metres")
    return float(value)


def _mesh(points: np.ndarray, normals: np.ndarray, counts: np.ndarray, indices: np.ndarray) -> Mesh:
    return Mesh(
        points=np.ascontiguousarray(points, dtype=np.float32),
        normals=np.ascontiguousarray(normals, dtype=np.float32),
        face_vertex_counts=np.ascontiguousarray(counts, dtype=np.int32),
        face_vertex_indices=np.ascontiguousarray(indices, dtype=np.int32),
    )
