"""What stands beside a road, and on it: houses, trees, light posts, hydrants, a parked car, a barrier, a jogger.

Few triangles, flat colours, convex pieces: hundreds of them must be drawn at a glance. Each asset stands on z = 0 and
looks along x; a part without a colour takes that of the individual. Sizes at scale 1 are those that the roadside
keeps room for (`echelon.terrain.roadside.SIZES`); eaves and the arms of light posts reach farther.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from echelon.export.drawn_parts import DrawnPart
from echelon.export.shapes import Mesh, capsule_between, joined, visual_mesh
from echelon.warp_kernels.model import Vec3, Visual

# Linear RGB.
PLASTER: tuple[Vec3, ...] = (
    (0.62, 0.56, 0.45), (0.55, 0.40, 0.26), (0.66, 0.64, 0.60),
    (0.42, 0.17, 0.11), (0.48, 0.53, 0.52), (0.60, 0.48, 0.22),
)  # fmt: skip
FOLIAGE: tuple[Vec3, ...] = ((0.075, 0.170, 0.035), (0.110, 0.205, 0.045), (0.150, 0.190, 0.035), (0.035, 0.105, 0.050))
IRON: tuple[Vec3, ...] = ((0.16, 0.18, 0.18),)
ENAMEL: tuple[Vec3, ...] = ((0.50, 0.035, 0.025), (0.62, 0.42, 0.03))
INDIVIDUAL_COLORS: Mapping[str, tuple[Vec3, ...]] = {
    "house": PLASTER,
    "tree": FOLIAGE,
    "lamp": IRON,
    "hydrant": ENAMEL,
}
"""The colours that each kind comes in, by the colour number of a placement."""

_TILE: Vec3 = (0.23, 0.075, 0.045)
_SLATE: Vec3 = (0.085, 0.09, 0.10)
_GLASS: Vec3 = (0.035, 0.05, 0.065)
_DOOR: Vec3 = (0.10, 0.06, 0.035)
_TRIM: Vec3 = (0.72, 0.70, 0.64)
_BARK: Vec3 = (0.105, 0.070, 0.045)
_BULB: Vec3 = (0.85, 0.82, 0.66)
_TYRE: Vec3 = (0.015, 0.015, 0.016)
_PAINT: Vec3 = (0.06, 0.12, 0.24)
_TAIL: Vec3 = (0.55, 0.02, 0.02)
_RED: Vec3 = (0.55, 0.03, 0.02)
_WHITE: Vec3 = (0.75, 0.74, 0.70)
_SKIN: Vec3 = (0.36, 0.18, 0.105)
_HAIR: Vec3 = (0.05, 0.03, 0.02)
_SHORTS: Vec3 = (0.02, 0.025, 0.045)
_SHIRT: Vec3 = (0.75, 0.62, 0.02)
_SHOES: Vec3 = (0.65, 0.13, 0.03)

CONIFER = 3
"""The colour number of trees that are conifers."""

VARIANTS: Mapping[str, tuple[str, ...]] = {
    "house": ("house", "townhouse"),
    "tree": ("broadleaf", "conifer"),
    "lamp": ("lamp",),
    "hydrant": ("hydrant",),
}
"""Names of the assets that a kind of roadside object comes in."""


def variant(kind: str, colors: np.ndarray) -> np.ndarray:
    """Which of a kind's `VARIANTS` objects of some colour numbers are, int32, same shape."""
    if kind == "house":
        return (colors % 2).astype(np.int32)
    return (colors == CONIFER).astype(np.int32) if kind == "tree" else np.zeros_like(colors, dtype=np.int32)


@cache
def asset(name: str) -> tuple[DrawnPart, ...]:
    """Parts of a roadside object by the name of its variant."""
    builders = {
        "house": lambda: _house(roof=_TILE, wall=4.6, ridge=7.5),
        "townhouse": lambda: _house(roof=_SLATE, wall=5.6, ridge=7.5),
        "broadleaf": _broadleaf,
        "conifer": _conifer,
        "lamp": _lamp,
        "hydrant": _hydrant,
    }
    return tuple(builders[name]())


def obstacle(kind: str, length: float, width: float) -> tuple[DrawnPart, ...]:
    """Parts of something on the road, so long and so wide [m]: "car", or "barrier" for everything else."""
    return _car(length, width) if kind == "car" else _barrier(length, width)


# ---- beside the road -----------------------------------------------------------------------------------------------
def _house(roof: Vec3, wall: float, ridge: float) -> list[DrawnPart]:
    """Two floors under a gable whose ridge runs along the road; 8 by 10 m."""
    deep, wide, eaves, thick = 4.0, 5.0, 0.45, 0.22
    profile = [(deep, -1.2), (deep, wall), (0.0, ridge - thick), (-deep, wall), (-deep, -1.2)]
    slope = (ridge - wall) / deep
    panes, frames = [], []
    for side in (1.0, -1.0):
        for level in (1.45, wall - 1.25):
            for y in (-3.2, 0.0, 3.2):
                if side > 0.0 and level < 2.0 and y == 0.0:
                    continue
                panes.append(_pane(side * (deep + 0.05), y, level, 0.5, 0.65))
                frames.append(_pane(side * (deep + 0.025), y, level, 0.6, 0.75))
    # The two slopes of the roof do not touch: four faces at one edge are no surface.
    slabs = [
        extruded(
            [
                (side * 0.005, ridge),
                (side * 0.005, ridge - thick),
                (side * (deep + eaves), wall - slope * eaves - thick),
                (side * (deep + eaves), wall - slope * eaves),
            ],
            wide + eaves,
        )
        for side in (1.0, -1.0)
    ]
    return [
        DrawnPart(extruded(profile, wide), None),
        DrawnPart(joined(slabs), roof),
        DrawnPart(joined(frames), _TRIM),
        DrawnPart(joined(panes), _GLASS),
        DrawnPart(_pane(deep + 0.05, 0.0, 1.0, 0.5, 1.05), _DOOR),
        DrawnPart(_box((-1.4, 2.6, ridge - 0.5), (0.35, 0.35, 1.0)), _TILE),
    ]


def _broadleaf() -> list[DrawnPart]:
    blobs = [
        ((0.0, 0.0, 5.0), (1.85, 1.85, 2.2)),
        ((0.75, 0.55, 4.0), (1.45, 1.4, 1.5)),
        ((-0.8, 0.35, 4.2), (1.4, 1.4, 1.45)),
        ((0.0, -0.85, 4.1), (1.45, 1.35, 1.5)),
    ]
    return [
        DrawnPart(turned([(0.26, -0.6), (0.17, 1.6), (0.10, 4.4)], 6), _BARK),
        DrawnPart(joined([_blob(center, radii) for center, radii in blobs]), None),
    ]


def _conifer() -> list[DrawnPart]:
    tiers = [((2.1, 1.2), (0.0, 4.4)), ((1.65, 2.9), (0.0, 5.9)), ((1.15, 4.6), (0.0, 7.5))]
    return [
        DrawnPart(turned([(0.20, -0.6), (0.14, 2.0)], 6), _BARK),
        DrawnPart(joined([turned([(0.0, foot[1] - 0.1), foot, tip], 9) for foot, tip in tiers]), None),
    ]


def _lamp() -> list[DrawnPart]:
    post = turned([(0.15, -0.3), (0.13, 0.9), (0.07, 0.95), (0.05, 6.8), (0.0, 6.85)], 6)
    arm = extruded([(0.0, 6.68), (1.8, 6.95), (1.8, 7.03), (0.0, 6.78)], 0.04)
    return [
        DrawnPart(joined([post, arm]), None),
        DrawnPart(_box((2.05, 0.0, 6.99), (0.32, 0.12, 0.05)), None),
        DrawnPart(_box((2.08, 0.0, 6.925), (0.24, 0.09, 0.02)), _BULB),
    ]


def _hydrant() -> list[DrawnPart]:
    barrel = turned(
        [(0.17, -0.1), (0.17, 0.06), (0.125, 0.07), (0.125, 0.58), (0.15, 0.59), (0.13, 0.68), (0.0, 0.8)], 9
    )
    nozzles = [_box((0.0, 0.0, 0.45), (0.055, 0.2, 0.055)), _box((0.14, 0.0, 0.45), (0.06, 0.07, 0.07))]
    return [DrawnPart(joined([barrel, *nozzles]), None)]


# ---- on the road ---------------------------------------------------------------------------------------------------
def _car(length: float, width: float) -> tuple[DrawnPart, ...]:
    """A parked car: x along it, its bonnet in front."""
    half, side = 0.5 * length, 0.5 * width
    body = [
        (half, 0.28), (half, 0.62), (half - 0.12, 0.72), (0.2 * half, 0.86),
        (-half + 0.1, 0.88), (-half, 0.78), (-half, 0.28),
    ]  # fmt: skip
    cabin = [(0.38 * half, 0.84), (0.10 * half, 1.40), (-0.62 * half, 1.43), (-0.90 * half, 0.86)]
    glass = [(0.40 * half, 0.87), (0.13 * half, 1.33), (-0.64 * half, 1.36), (-0.92 * half, 0.88)]
    pillar = [(-0.16 * half, 0.86), (-0.16 * half, 1.38), (-0.22 * half, 1.38), (-0.22 * half, 0.86)]
    wheels, hubs = [], []
    turned_over = (float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5)))
    for x in (0.62 * half, -0.60 * half):
        for y in (side - 0.10, -side + 0.10):
            wheels.append(visual_mesh(Visual("cylinder", (0.32, 0.11, 0.0), (x, y, 0.32), turned_over)))
            hubs.append(visual_mesh(Visual("cylinder", (0.19, 0.12, 0.0), (x, y, 0.32), turned_over)))
    lights = [_box((half, y, 0.60), (0.02, 0.16, 0.06)) for y in (side - 0.25, -side + 0.25)]
    tails = [_box((-half, y, 0.72), (0.02, 0.14, 0.08)) for y in (side - 0.22, -side + 0.22)]
    return (
        DrawnPart(joined([extruded(body, side), extruded(cabin, 0.82 * side), extruded(pillar, 0.845 * side)]), _PAINT),
        DrawnPart(extruded(glass, 0.83 * side), _GLASS),
        DrawnPart(joined(wheels), _TYRE),
        DrawnPart(joined(hubs), _TRIM),
        DrawnPart(joined(lights), _BULB),
        DrawnPart(joined(tails), _TAIL),
    )


def _barrier(length: float, width: float) -> tuple[DrawnPart, ...]:
    """Boards in red and white on posts, around what is closed off."""
    half = np.array([0.5 * length, 0.5 * width])
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * (half - 0.06)
    boards: dict[Vec3, list[Mesh]] = {_RED: [], _WHITE: []}
    posts = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        span = end - start
        count = max(round(float(np.linalg.norm(span)) / 0.6), 1)
        along_x = abs(span[0]) > abs(span[1])
        for index in range(count):
            middle = start + (index + 0.5) / count * span
            reach = 0.5 * float(np.linalg.norm(span)) / count
            size = (reach, 0.03, 0.13) if along_x else (0.03, reach, 0.13)
            for height in (0.92, 0.42):
                boards[_RED if index % 2 else _WHITE].append(_box((middle[0], middle[1], height), size))
        posts.append(_box((start[0], start[1], 0.5), (0.05, 0.05, 0.55)))
        posts.append(_box((start[0], start[1], 0.04), (0.22, 0.22, 0.04)))
    return (
        DrawnPart(joined(boards[_RED]), _RED),
        DrawnPart(joined(boards[_WHITE]), _WHITE),
        DrawnPart(joined(posts), _SLATE),
    )


def jogger_visuals() -> tuple[Visual, ...]:
    """Somebody who runs along x, in mid stride; 1.78 m tall, the ground is z = 0."""
    parts = [
        Visual("ellipsoid", (0.105, 0.085, 0.125), (0.09, 0.0, 1.65), color=_SKIN),
        Visual("ellipsoid", (0.108, 0.09, 0.09), (0.075, 0.0, 1.70), color=_HAIR),
        capsule_between((0.04, 0.0, 1.40), (0.07, 0.0, 1.54), 0.05, _SKIN),
        capsule_between((-0.02, 0.06, 1.02), (0.04, 0.08, 1.36), 0.115, _SHIRT),
        capsule_between((-0.02, -0.06, 1.02), (0.04, -0.08, 1.36), 0.115, _SHIRT),
        capsule_between((-0.03, 0.07, 0.92), (-0.03, -0.07, 0.92), 0.12, _SHORTS),
    ]
    for side, knee, ankle, toe in (
        (1.0, (0.34, 0.66), (0.16, 0.30), (0.30, 0.25)),
        (-1.0, (-0.06, 0.50), (-0.20, 0.12), (-0.06, 0.05)),
    ):
        hip = (-0.02, 0.09 * side, 0.90)
        middle = (0.5 * (hip[0] + knee[0]), hip[1], 0.5 * (hip[2] + knee[1]))
        parts += [
            capsule_between(hip, middle, 0.088, _SHORTS),
            capsule_between(middle, (knee[0], hip[1], knee[1]), 0.068, _SKIN),
            capsule_between((knee[0], hip[1], knee[1]), (ankle[0], hip[1], ankle[1]), 0.05, _SKIN),
            capsule_between((ankle[0], hip[1], ankle[1] - 0.03), (toe[0], hip[1], toe[1]), 0.045, _SHOES),
        ]
    for side, elbow, hand in ((1.0, (-0.22, 1.18), (-0.05, 1.03)), (-1.0, (0.02, 1.10), (0.27, 1.20))):
        shoulder = (0.04, 0.20 * side, 1.38)
        parts += [
            capsule_between(shoulder, (elbow[0], 0.25 * side, elbow[1]), 0.05, _SHIRT),
            capsule_between((elbow[0], 0.25 * side, elbow[1]), (hand[0], 0.20 * side, hand[1]), 0.038, _SKIN),
        ]
    return tuple(parts)


# ---- solids --------------------------------------------------------------------------------------------------------
def extruded(profile: Sequence[tuple[float, float]], half_width: float) -> Mesh:
    """A prism: a convex outline (x, z), either way round, drawn out to y = half_width on both sides [m]."""
    outline = np.asarray(profile, dtype=float)
    ahead = np.roll(outline, -1, axis=0)
    if float((outline[:, 0] * ahead[:, 1] - outline[:, 1] * ahead[:, 0]).sum()) > 0.0:
        outline = outline[::-1]
        ahead = np.roll(outline, -1, axis=0)
    # Clockwise seen from where x points right and z up, which is counter-clockwise seen from y > 0.
    count = len(outline)
    points, normals, faces = [], [], []
    for index in range(count):
        (x0, z0), (x1, z1) = outline[index], ahead[index]
        across = np.array([-(z1 - z0), 0.0, x1 - x0])
        across /= max(float(np.linalg.norm(across)), 1e-12)
        points += [(x0, half_width, z0), (x0, -half_width, z0), (x1, -half_width, z1), (x1, half_width, z1)]
        normals += [across] * 4
        faces.append(np.arange(4) + 4 * index)
    first = 4 * count
    points += [(x, half_width, z) for x, z in outline] + [(x, -half_width, z) for x, z in outline]
    normals += [np.array([0.0, 1.0, 0.0])] * count + [np.array([0.0, -1.0, 0.0])] * count
    faces += [first + np.arange(count), first + count + np.arange(count)[::-1]]
    return _mesh(points, normals, faces)


def turned(profile: Sequence[tuple[float, float]], segments: int) -> Mesh:
    """A solid of revolution about z: a profile (radius, z) from its foot to its top [m], flat from ring to ring."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    points, normals, faces = [], [], []
    for (r0, z0), (r1, z1) in pairwise(profile):
        slope = np.array([z1 - z0, r0 - r1])
        slope /= max(float(np.linalg.norm(slope)), 1e-12)
        first = len(points)
        for radius, z in ((r0, z0), (r1, z1)):
            points += [(radius * x, radius * y, z) for x, y in around]
            normals += [np.array([slope[0] * x, slope[0] * y, slope[1]]) for x, y in around]
        for here in range(segments):
            after = (here + 1) % segments
            lower, upper = (first + here, first + after), (first + segments + here, first + segments + after)
            if r0 <= 0.0:
                faces.append(np.array([lower[0], upper[1], upper[0]]))
            elif r1 <= 0.0:
                faces.append(np.array([lower[0], lower[1], upper[0]]))
            else:
                faces.append(np.array([lower[0], lower[1], upper[1], upper[0]]))
    return _mesh(points, normals, faces)


def _blob(center: Vec3, radii: Vec3) -> Mesh:
    """A coarse ellipsoid: 7 around, 5 bands from pole to pole."""
    polar = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 6)
    ball = turned(
        [(max(float(np.cos(p)), 0.0) if 0 < i < 5 else 0.0, float(np.sin(p))) for i, p in enumerate(polar)], 7
    )
    # Smooth: its own directions are better normals than those of its bands.
    unit = ball.points / np.linalg.norm(ball.points, axis=1, keepdims=True)
    normals = unit / np.asarray(radii)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        points=(unit * np.asarray(radii) + np.asarray(center)).astype(np.float32),
        normals=normals.astype(np.float32),
        face_vertex_counts=ball.face_vertex_counts,
        face_vertex_indices=ball.face_vertex_indices,
    )


def _box(center: Sequence[float], half_size: Vec3) -> Mesh:
    return visual_mesh(Visual("box", half_size, (float(center[0]), float(center[1]), float(center[2]))))


def _pane(x: float, y: float, z: float, half_width: float, half_height: float) -> Mesh:
    """An upright rectangle that looks away from x = 0."""
    side = 1.0 if x > 0.0 else -1.0
    corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
    points = [(x, y + side * a * half_width, z + b * half_height) for a, b in corners]
    return _mesh(points, [(side, 0.0, 0.0)] * 4, [np.arange(4)])


def _mesh(points: Sequence, normals: Sequence, faces: Sequence[np.ndarray]) -> Mesh:
    return Mesh(
        points=np.asarray(points, dtype=np.float32),
        normals=np.asarray(normals, dtype=np.float32),
        face_vertex_counts=np.array([len(face) for face in faces], dtype=np.int32),
        face_vertex_indices=np.concatenate(faces).astype(np.int32),
    )
