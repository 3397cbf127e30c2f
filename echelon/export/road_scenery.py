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
from scipy.spatial import KDTree

from echelon.export.displayed_ground import DisplayedGround
from echelon.export.drawn_road import DrawnRoad, DrawnThings
from echelon.export.ground_colors import ground_albedo
from echelon.export.light import SHADOW_COLOR, STANDING_SHADOWS, display_encoded, flattened, lit
from echelon.export.mesh_parts import separate_parts
from echelon.export.renderer import Surface, joined
from echelon.export.road_scene import GroundPart
from echelon.export.scenery import HAZE, HORIZON, MEADOW, hills, sky
from echelon.export.shapes import joined as joined_meshes

CELL = 24.0  # [m] of the grid of windows
GROUND_REACH = 1500.0  # [m] from the middle of a window
FINE_GROUND = ((38.0, 1.6), (85.0, 4.0), (190.0, 12.0))  # [m]: within so far, triangles are no longer than that
MOST_CUTS = 40  # of a triangle's side
THING_REACH = {"house": 1000.0, "townhouse": 1000.0, "lamp": 260.0, "hydrant": 110.0}
OTHER_REACH = 650.0  # [m], of trees and what else there is
SHADOW_REACH = 110.0  # [m]
HAZE_REACH = 1050.0  # [m] at which half of a colour is lost
SHADOW_LIFT = 0.013  # [m] of shadows above the road, so that paint lies beneath them
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
        self._skirt = _skirt([part.part for part in self._parts if part.part.name == "land"])

    def heights(self, places: np.ndarray) -> np.ndarray:
        """Heights of the ground nearest to places [m], shapes [n] and [n, 3]."""
        return self._ground.heights(places)

    def shadow_planes(self, places: np.ndarray) -> np.ndarray:
        """The planes n . x = d on which shadows of bodies at places [m] fall, shapes [n, 4] and [n, 3]."""
        planes = self._ground.planes(places)
        planes[:, 3] += SHADOW_LIFT
        return planes

    def cell(self, eye: np.ndarray) -> tuple[int, int, int]:
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
        self._normals = part.mesh.normals[triangles].astype(np.float64)
        self._uv = None if part.uv is None else part.uv[triangles].astype(np.float64)
        plan = self.corners[..., :2]
        self._centers = plan.mean(axis=1)
        self._radii = np.linalg.norm(plan - self._centers[:, None], axis=2).max(axis=1)
        sides = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=1), axis=2)
        self._sides = sides.max(axis=1)

    def surface(self, middle: np.ndarray, origin: np.ndarray) -> Surface | None:
        distance = np.maximum(np.linalg.norm(self._centers - middle[:2], axis=1) - self._radii, 0.0)
        near = np.flatnonzero(distance < GROUND_REACH)
        if not len(near):
            return None
        cuts = np.ones(len(near), dtype=np.int64)
        if self.part.name != "paint":
            for reach, length in reversed(FINE_GROUND):
                fine = distance[near] < reach
                cuts[fine] = np.clip(np.ceil(self._sides[near[fine]] / length), 1, MOST_CUTS).astype(np.int64)
        surfaces = [self._cut(near[cuts == count], int(count), middle, origin) for count in np.unique(cuts)]
        return joined(surfaces)

    def _cut(self, chosen: np.ndarray, count: int, middle: np.ndarray, origin: np.ndarray) -> Surface:
        """Some triangles, each side cut into so many."""
        weights, template = _subdivision(count)
        points = (weights @ self.corners[chosen]).reshape(-1, 3)
        normals = (weights @ self._normals[chosen]).reshape(-1, 3)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        uv = None if self._uv is None else (weights @ self._uv[chosen]).reshape(-1, 2)
        spacing = np.repeat(self._sides[chosen] / count, len(weights))
        albedo = ground_albedo(self.part.name, np.array(self.part.color), points[:, :2], uv, spacing)
        distance = np.linalg.norm(points - middle, axis=1)
        colors = hazy(lit(albedo, normals.astype(np.float32)), distance)
        triangles = (template + len(weights) * np.arange(len(chosen))[:, None, None]).reshape(-1, 3)
        return Surface((points - origin).astype(np.float32), colors, triangles)


def _subdivision(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights of the points of a triangle whose sides are cut into so many, and its small triangles."""
    rows = [(i, j) for i in range(count + 1) for j in range(count + 1 - i)]
    number = {place: index for index, place in enumerate(rows)}
    triangles = []
    for i, j in rows:
        if i + j < count:
            triangles.append((number[i, j], number[i + 1, j], number[i, j + 1]))
        if i + j < count - 1:
            triangles.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    weights = np.array([[count - i - j, i, j] for i, j in rows]) / count
    return weights, np.array(triangles)


def _skirt(land: list[GroundPart]) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles from the outer edge of the land outwards, as far as can be seen [m]."""
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
        self._piece = separate_parts(whole)
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
        positions = self._things.positions[near]
        planes = ground.planes(positions)
        # Things that stand side by side may overlap in shadow: layers of their own as far as there are any.
        layer = self._piece[None] + (int(self._piece.max()) + 1) * near[:, None]
        heights = STANDING_SHADOWS.heights(layer, int(self._piece.max()) + 1)
        flat = flattened(self._placed(near), np.zeros(heights.shape), planes[:, None]).reshape(-1, 3)
        flat[:, 2] = ground.heights(flat) + SHADOW_LIFT + heights.reshape(-1)
        triangles = self._triangles + len(self._points) * np.arange(len(near))[:, None, None]
        triangles = triangles.reshape(-1, 3)
        # Layers are drawn from the top down: the depth test lets only the first one darken.
        order = np.argsort(-heights.reshape(-1)[triangles[:, 0]], kind="stable")
        colors = np.broadcast_to(SHADOW_COLOR, (len(flat), 4))
        return Surface((flat - origin).astype(np.float32), colors, triangles[order])

    def _placed(self, near: np.ndarray) -> np.ndarray:
        """Points of some things in the world [m], shape [things, points, 3]."""
        turned = self._points @ self._things.frames[near].transpose(0, 2, 1)
        return turned + self._things.positions[near][:, None]


def _shifted(surface: Surface, height: float) -> Surface:
    points = surface.points.copy()
    points[:, 2] += np.float32(height)
    return Surface(points, surface.colors, surface.triangles)
