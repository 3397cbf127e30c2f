"""What stands still along a road, near the camera: sky, ground, paint, houses, trees and their shadows.

A road is kilometres long and a picture shows some hundred metres of it. So what is drawn is a *window*: everything
within reach of a cell of space in which the camera is, lit, coloured, faded into the haze by its distance from the
middle of the cell, and merged. As long as the camera stays in the cell, nothing changes; a picture depends on where
the camera is and not on how it came there.

Ground near the window's middle is cut finer, so that vertex colours can carry the grain of asphalt and grass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from echelon.export.displayed_ground import DisplayedGround
from echelon.export.drawn_road import DrawnRoad, DrawnThings
from echelon.export.ground_colors import ground_albedo
from echelon.export.light import SHADOW_COLOR, ShadowLayers, display_encoded, flattened, lit
from echelon.export.mesh_parts import separate_parts
from echelon.export.renderer import Surface, joined
from echelon.export.road_scene import GroundPart
from echelon.export.scenery import HAZE, HORIZON, MEADOW, hills, sky
from echelon.export.shapes import Mesh
from echelon.export.shapes import joined as joined_meshes
from echelon.warp_kernels.model import Vec3

CELL = 24.0  # [m] of the grid of windows
GROUND_REACH = 1500.0  # [m] from the middle of a window
FINE_GROUND = (
    (190.0, 10.0),
    (70.0, 3.0),
    (32.0, 1.0),
    (13.0, 0.45),
)  # [m]: within so far, triangles are no longer than that
THING_REACH = {"house": 1000.0, "townhouse": 1000.0, "lamp": 260.0, "hydrant": 110.0}
OTHER_REACH = 650.0  # [m], of trees and what else there is
SHADOW_REACH = 110.0  # [m]
HAZE_REACH = 1050.0  # [m] at which half of a colour is lost
SHADOW_LIFT = 0.013  # [m] of shadows above the road, so that paint lies beneath them
SHADOW_CUT = 1.5  # [m], length of the pieces in which shadows lie on the ground
STANDING = ShadowLayers(top=0.016, bottom=0.002, least_count=5)
SOLID_THINGS = ("house", "townhouse", "car", "barrier")  # whose shadow is that of their hull
SLENDER_THINGS = ("lamp", "hydrant")  # whose pieces each have a shadow of their own
SKIRT_DEPTH = 6.0  # [m] that the ground beyond the land lies lower, far away


@dataclass(frozen=True)
class Window:
    """What is drawn while the camera is in one cell.

    Attributes:
        cell: Which one.
        origin: What the surfaces count from [m], shape [3].
        surfaces: Solid ones, then transparent ones.
    """

    cell: tuple[int, int, int]
    origin: np.ndarray
    surfaces: list[Surface]


class RoadScenery:
    """The scenery of a road, window by window."""

    def __init__(self, road: DrawnRoad) -> None:
        self._parts = [_Ground(part) for part in road.ground]
        self._things = [_Things(things) for things in road.things]
        solid = [part.corners for part in self._parts if part.part.name != "paint"]
        self._ground = DisplayedGround(np.concatenate([np.empty((0, 3, 3)), *solid]))
        self._skirt = skirt([part.part for part in self._parts if part.part.name == "land"])

    def heights(self, places: np.ndarray) -> np.ndarray:
        """Heights of the ground nearest to places [m], shapes [n] and [n, 3]."""
        return self._ground.heights(places)

    def shadow_planes(self, places: np.ndarray) -> np.ndarray:
        """The planes n . x = d on which shadows of bodies at places [m] fall, shapes [n, 4] and [n, 3]."""
        planes = self._ground.planes(places)
        planes[:, 3] += SHADOW_LIFT
        return planes

    def cell(self, eye: Vec3) -> tuple[int, int, int]:
        """In which cell a camera is [m]."""
        x, y, z = np.floor(np.asarray(eye) / CELL).astype(int).tolist()
        return (x, y, z)

    def window(self, cell: tuple[int, int, int]) -> Window:
        """What is drawn while the camera is in a cell."""
        middle = CELL * (np.array(cell) + 0.5)
        # The renderer wants every eye above its origin.
        origin = np.array([middle[0], middle[1], CELL * cell[2] - 1.0])
        things = [surface for thing in self._things for surface in [thing.surface(middle, origin)] if surface]
        ground = [surface for part in self._parts for surface in [part.surface(middle, origin)] if surface]
        level = float(self.heights(middle[None])[0]) - origin[2]
        behind = [
            self._skirt_surface(origin),
            _shifted(hills(np.zeros(2), 1450.0, 55.0, 0.72), level - SKIRT_DEPTH - 8.0),
            _shifted(sky(np.zeros(2)), level - 20.0),
        ]
        shadows = [
            shadow for thing in self._things for shadow in [thing.shadow(middle, origin, self._ground)] if shadow
        ]
        opaque = joined([*things, *reversed(ground), *behind])
        return Window(cell, origin, [opaque, joined(shadows)] if shadows else [opaque])

    def _skirt_surface(self, origin: np.ndarray) -> Surface:
        """Meadow from the edge of the land to the horizon."""
        points, triangles = self._skirt
        shifted = points - origin
        distance = np.linalg.norm(shifted[:, :2], axis=1)
        # Beyond the sky there is nothing to see, and what is too far away is cut off.
        shifted[:, :2] *= np.minimum(1.0, 1.2 * HORIZON / np.maximum(distance, 1e-9))[:, None]
        up = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), shifted.shape)
        colors = hazy(lit(np.broadcast_to(MEADOW, shifted.shape), up), distance)
        return Surface(shifted.astype(np.float32), colors, triangles)


def hazy(colors: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Colours [n, 3] at distances [m] [n], seen through the air, with an opacity of 1; shape [n, 4]."""
    lost = (1.0 - 0.5 ** ((distance / HAZE_REACH) ** 1.6))[:, None].astype(np.float32)
    seen = colors + lost * (display_encoded(HAZE) - colors)
    return np.concatenate([seen, np.ones((len(seen), 1))], axis=1).astype(np.float32)


# ---- ground --------------------------------------------------------------------------------------------------------
class _Ground:
    """A part of the ground, ready to be cut to windows."""

    def __init__(self, part: GroundPart) -> None:
        triangles = part.mesh.triangles
        self.part = part
        self.corners = part.mesh.points[triangles].astype(np.float64)
        columns = [self.corners, part.mesh.normals[triangles].astype(np.float64)]
        if part.uv is not None:
            columns.append(part.uv[triangles].astype(np.float64))
        self._rows = np.concatenate(columns, axis=2)
        plan = self.corners[..., :2]
        self._centers = plan.mean(axis=1)
        self._radii = np.linalg.norm(plan - self._centers[:, None], axis=2).max(axis=1)

    def surface(self, middle: np.ndarray, origin: np.ndarray) -> Surface | None:
        near = np.linalg.norm(self._centers - middle[:2], axis=1) - self._radii < GROUND_REACH
        rows = self._rows[near]
        if not len(rows):
            return None
        if self.part.name != "paint":
            for reach, length in FINE_GROUND:
                plan = rows[..., :2]
                centers = plan.mean(axis=1)
                radii = np.linalg.norm(plan - centers[:, None], axis=2).max(axis=1)
                close = np.linalg.norm(centers - middle[:2], axis=1) - radii < reach
                rows = np.concatenate([rows[~close], bisected(rows[close], length)])
        sides = np.linalg.norm(rows[..., :3] - np.roll(rows[..., :3], 1, axis=1), axis=2).max(axis=1)
        flat = rows.reshape(-1, rows.shape[2])
        points, normals = flat[:, :3], flat[:, 3:6] / np.linalg.norm(flat[:, 3:6], axis=1, keepdims=True)
        uv = flat[:, 6:8] if flat.shape[1] > 6 else None
        albedo = ground_albedo(self.part.name, np.array(self.part.color), points[:, :2], uv, np.repeat(sides, 3))
        distance = np.linalg.norm(points - middle, axis=1)
        colors = hazy(lit(albedo, normals.astype(np.float32)), distance)
        return Surface((points - origin).astype(np.float32), colors, np.arange(len(flat)).reshape(-1, 3))


def bisected(rows: np.ndarray, length: float) -> np.ndarray:
    """Triangles halved across their longest side until no side is longer than a length [m].

    Args:
        rows: Of each corner the point, then whatever else is to be interpolated, shape [triangles, 3, columns].
        length: [m].
    """
    done = [rows[:0]]
    while len(rows):
        sides = np.linalg.norm(rows[:, [1, 2, 0], :3] - rows[..., :3], axis=2)
        longest = sides.argmax(axis=1)
        halved = sides[np.arange(len(rows)), longest] > length
        done.append(rows[~halved])
        rows, longest = rows[halved], longest[halved]
        # Turned so that the longest side runs from the first corner to the second.
        turn = (longest[:, None] + np.arange(3)) % 3
        a, b, c = (rows[np.arange(len(rows)), turn[:, corner]] for corner in range(3))
        middle = 0.5 * (a + b)
        rows = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def skirt(land: list[GroundPart]) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles from the outer edge of the land outwards, as far as can be seen [m]; none without land."""
    if not land:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    mesh = joined_meshes([part.mesh for part in land])
    triangles = mesh.triangles
    sides = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    count = len(mesh.points)
    codes, counts = np.unique(np.sort(sides, axis=1) @ [count, 1], return_counts=True)
    rims = sides[np.isin(np.sort(sides, axis=1) @ [count, 1], codes[counts == 1])]
    points = mesh.points.astype(np.float64)
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    # The hole that the road leaves in the land has a rim too: only the outer one counts.
    on_edge = (np.minimum(points[:, :2] - low, high - points[:, :2]) < 0.5).any(axis=1)
    rims = rims[on_edge[rims].all(axis=1)]
    middle = 0.5 * (low + high)
    starts, ends = points[rims[:, 0]], points[rims[:, 1]]

    def outward(place: np.ndarray) -> np.ndarray:
        away = place[:, :2] - middle
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return np.column_stack([place[:, :2] + 2.0 * HORIZON * away, place[:, 2] - SKIRT_DEPTH])

    rows = np.stack([starts, ends, outward(ends), outward(starts)], axis=1).reshape(-1, 3)
    first = 4 * np.arange(len(rims))[:, None]
    return rows, np.concatenate([first + [0, 2, 1], first + [0, 3, 2]])


# ---- things --------------------------------------------------------------------------------------------------------
class _Things:
    """Things that look alike, ready to be put into windows."""

    def __init__(self, things: DrawnThings) -> None:
        meshes = [part.mesh for part in things.parts]
        whole = joined_meshes(meshes)
        self._things = things
        self._points, self._normals = whole.points.astype(np.float64), whole.normals.astype(np.float64)
        self._triangles = whole.triangles.astype(np.int64)
        sizes = [len(mesh.points) for mesh in meshes]
        self._own = np.repeat([part.color is None for part in things.parts], sizes)
        self._albedo = np.repeat(np.array([part.color or (0.0, 0.0, 0.0) for part in things.parts]), sizes, axis=0)
        self._outlines = _outlines(things, whole)
        self._reach = THING_REACH.get(things.name, OTHER_REACH)
        self._tree = KDTree(things.positions[:, :2])

    def surface(self, middle: np.ndarray, origin: np.ndarray) -> Surface | None:
        near = np.sort(self._tree.query_ball_point(middle[:2], self._reach)).astype(np.int64)
        if not len(near):
            return None
        frames = self._things.frames[near]
        points = self._placed(near)
        # Normals of what is stretched are stretched the other way.
        normals = self._normals @ np.linalg.inv(frames)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        albedo = np.where(self._own[:, None], self._things.colors[near][:, None], self._albedo)
        distance = np.repeat(np.linalg.norm(self._things.positions[near] - middle, axis=1), len(self._points))
        colors = hazy(lit(albedo.astype(np.float32), normals.astype(np.float32)).reshape(-1, 3), distance)
        triangles = self._triangles + len(self._points) * np.arange(len(near))[:, None, None]
        return Surface((points - origin).reshape(-1, 3).astype(np.float32), colors, triangles.reshape(-1, 3))

    def shadow(self, middle: np.ndarray, origin: np.ndarray, ground: DisplayedGround) -> Surface | None:
        """Shadows of those that are near, laid on the ground."""
        near = np.sort(self._tree.query_ball_point(middle[:2], min(SHADOW_REACH, self._reach))).astype(np.int64)
        if not len(near):
            return None
        planes = ground.planes(self._things.positions[near])
        flat = flattened(self._placed(near), np.zeros((len(near), len(self._points))), planes[:, None])
        surfaces = []
        for row, thing in enumerate(near.tolist()):
            for number, members in enumerate(self._outlines):
                # Neighbours overlap in shadow: layers of their own, as far as there are any.
                layer = np.array(len(self._outlines) * thing + number)
                rows = bisected(_filled(flat[row, members]), SHADOW_CUT)
                points = rows.reshape(-1, 3)
                points[:, 2] = ground.heights(points) + SHADOW_LIFT + float(STANDING.heights(layer, 1))
                surfaces.append((int(layer) % STANDING.least_count, (points - origin).astype(np.float32)))
        # Layers are drawn from the top down: the depth test lets only the first one darken.
        points = np.concatenate([points for _, points in sorted(surfaces, key=lambda entry: entry[0])])
        colors = np.broadcast_to(SHADOW_COLOR, (len(points), 4))
        return Surface(points, colors, np.arange(len(points)).reshape(-1, 3))

    def _placed(self, near: np.ndarray) -> np.ndarray:
        """Points of some things in the world [m], shape [things, points, 3]."""
        turned = self._points @ self._things.frames[near].transpose(0, 2, 1)
        return turned + self._things.positions[near][:, None]


def _outlines(things: DrawnThings, whole: Mesh) -> list[np.ndarray]:
    """Indices of points whose hulls, laid flat, are the shadow: of the whole, of each part, or of each piece."""
    if things.name in SOLID_THINGS:
        return [np.arange(len(whole.points))]
    if things.name in SLENDER_THINGS:
        piece = separate_parts(whole)
        return [np.flatnonzero(piece == number) for number in range(int(piece.max()) + 1)]
    ends = np.cumsum([len(part.mesh.points) for part in things.parts])
    return [np.arange(end - len(part.mesh.points), end) for part, end in zip(things.parts, ends, strict=True)]


def _filled(points: np.ndarray) -> np.ndarray:
    """Triangles of the convex hull, on the map, of points [n, 3]; shape [triangles, 3, 3]."""
    try:
        outline = points[ConvexHull(points[:, :2]).vertices]
    except QhullError:  # all on a line
        return np.empty((0, 3, 3))
    here = np.arange(1, len(outline) - 1)
    return np.stack([np.broadcast_to(outline[0], (len(here), 3)), outline[here], outline[here + 1]], axis=1)


def _shifted(surface: Surface, height: float) -> Surface:
    points = surface.points.copy()
    points[:, 2] += np.float32(height)
    return Surface(points, surface.colors, surface.triangles)
