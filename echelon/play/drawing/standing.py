"""What stands still in the browser: the field or the road with everything around it, sent once.

Ground, fences and sky are lit here and shown as they are, which costs the browser least; a picture of grain repeats
itself over ground that somebody may ride across. Houses and trees are sent once each and placed, and light falls on
them in the browser. The browser's depth buffer is coarser than the films' is made to be: what lies on the ground is
lifted farther from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.export.displayed_ground import DisplayedGround
from echelon.export.drawn_road import DrawnRoad, DrawnThings
from echelon.export.ground_colors import ground_albedo
from echelon.export.light import LEVEL, lit
from echelon.export.picture_source import DrawnWorld
from echelon.export.renderer import Surface, joined
from echelon.export.road_scene import GroundPart
from echelon.export.road_scenery import skirt
from echelon.export.scenery import HORIZON, MEADOW, hills, scenery, sky
from echelon.play.drawing.browser_light import shown_as_is
from echelon.play.drawing.glb import ColoredMesh, glb
from echelon.play.drawing.grain import MEAN, SIZE, grain
from echelon.play.drawing.painted_parts import painted

FIELD_REACH = 40.0  # [m] each way from the origin: where the action is on ground without an outline
GRAIN_REACH = 320.0  # [m] from the origin: farther away the grain of a field cannot be seen
THIN = 0.001  # [m]: what lies less than this above level ground lies on it
THIN_LIFT = 20.0  # times as high
STANDING_SHADOW_LIFT = 0.012  # [m], above what lies on the ground
PAINT_LIFT = 0.015  # [m], more than in the films

TILE = 400.0  # [m]: pieces of a road's ground that are left out by themselves where they are out of sight
ROAD_SKY = 7000.0  # [m], radius of the sky over a road
ROAD_HILLS = ((3600.0, 70.0, 0.45), (5200.0, 190.0, 0.72))  # [m] away, [m] high, lost in haze
SKIRT_DROP = 12.0  # [m] that hills and sky begin below the lowest ground


@dataclass(frozen=True)
class Places:
    """Where copies of a thing stand, float32.

    Attributes:
        positions: [m],                                     [n, 3]
        wxyzs: Orientations, quaternion (w, x, y, z),       [n, 4]
        scales: Along their own axes,                       [n, 3]
    """

    positions: np.ndarray
    wxyzs: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True)
class Standing:
    """Something that stands still.

    Attributes:
        name: Unique.
        model: Binary glTF.
        places: Where its copies stand; None for one as it is.
    """

    name: str
    model: bytes
    places: Places | None = None


class Ground:
    """What shadows fall on."""

    def __init__(self, world: DrawnWorld) -> None:
        self._platform = world.platform
        self._displayed = None
        if world.road is not None:
            solid = [part for part in world.road.ground if part.name != "paint"]
            corners = [part.mesh.points[part.mesh.triangles].astype(np.float64) for part in solid]
            self._displayed = DisplayedGround(np.concatenate(corners))

    @property
    def is_level(self) -> bool:
        """Whether it is z = 0 everywhere."""
        return self._displayed is None and self._platform is None

    def planes(self, places: np.ndarray) -> np.ndarray:
        """The planes n . x = d beneath places [m], shapes [n, 4] and [n, 3]."""
        if self._displayed is not None:
            return self._displayed.planes(places)
        if self._platform is not None:
            return self._platform.planes(places)
        return np.broadcast_to(LEVEL, (len(places), 4))


def standing_things(world: DrawnWorld) -> list[Standing]:
    """All that stands still in a world."""
    return _road(world.road) if world.road is not None else _field(world)


# ---- a field -------------------------------------------------------------------------------------------------------
def _field(world: DrawnWorld) -> list[Standing]:
    corner = np.full(2, FIELD_REACH)
    surfaces = scenery(world, -corner, corner, np.zeros(2))
    solid, shadows = surfaces[0], surfaces[1:]
    points = solid.points.copy()
    lying = (points[:, 2] > 0.0) & (points[:, 2] <= THIN)
    points[lying, 2] *= THIN_LIFT
    near = (np.abs(solid.points[:, 2]) < 0.05) & (np.linalg.norm(solid.points[:, :2], axis=1) < GRAIN_REACH)
    ground = near[solid.triangles].all(axis=1)
    shown = Surface(points, solid.colors, solid.triangles)
    found = [
        Standing("ground", glb([_grainy(_chosen(shown, ground))], shaded=False, texture=grain())),
        Standing("around", glb([_chosen(shown, ~ground)], shaded=False)),
    ]
    if shadows:
        dark = joined(shadows)
        lifted = Surface(dark.points + _up(STANDING_SHADOW_LIFT), dark.colors, dark.triangles)
        everything = np.ones(len(dark.triangles), bool)
        found.append(Standing("shadows", glb([_chosen(lifted, everything)], shaded=False, see_through=True)))
    return found


def _chosen(surface: Surface, wanted: np.ndarray) -> ColoredMesh:
    """Some triangles of a surface, to be shown in its colours."""
    used, corners = np.unique(surface.triangles[wanted], return_inverse=True)
    colors = np.column_stack([shown_as_is(surface.colors[used, :3]), surface.colors[used, 3]])
    return ColoredMesh(surface.points[used], corners.reshape(-1, 3), colors)


def _grainy(mesh: ColoredMesh) -> ColoredMesh:
    """A mesh of ground, for the picture of grain."""
    colors = mesh.colors / [MEAN, MEAN, MEAN, 1.0]
    return ColoredMesh(mesh.points, mesh.triangles, colors, mesh.points[:, :2] / SIZE)


# ---- a road --------------------------------------------------------------------------------------------------------
def _road(road: DrawnRoad) -> list[Standing]:
    grainy = [tile for part in road.ground if part.name != "paint" for tile in _tiles(_lit_ground(part))]
    paint = [tile for part in road.ground if part.name == "paint" for tile in _tiles(_lit_ground(part))]
    found = [Standing("ground", glb([_grainy(tile) for tile in grainy], shaded=False, texture=grain()))]
    if paint:
        lift = _up(PAINT_LIFT)
        lifted = [ColoredMesh(tile.points + lift, tile.triangles, tile.colors) for tile in paint]
        found.append(Standing("paint", glb(lifted, shaded=False)))
    found.append(Standing("around", glb(_far_around(road), shaded=False)))
    for things in road.things:
        found += _copies(things)
    return found


def _lit_ground(part: GroundPart) -> ColoredMesh:
    """A part of the ground in sunlight, before the grain."""
    mesh = part.mesh
    triangles = mesh.triangles
    corners = mesh.points[triangles].astype(np.float64)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    spacing = np.zeros(len(mesh.points))
    for corner in range(3):
        np.maximum.at(spacing, triangles[:, corner], sides)
    uv = None if part.uv is None else part.uv.astype(np.float64)
    places = mesh.points[:, :2].astype(np.float64)
    albedo = ground_albedo(part.name, np.array(part.color), places, uv, spacing)
    colors = shown_as_is(lit(albedo, mesh.normals))
    return ColoredMesh(mesh.points, triangles, np.column_stack([colors, np.ones(len(colors))]))


def _tiles(mesh: ColoredMesh) -> list[ColoredMesh]:
    """A mesh cut into squares of the map, each with the triangles whose middle is there."""
    middle = np.floor(mesh.points[mesh.triangles][..., :2].mean(axis=1) / TILE).astype(np.int64)
    cells, number = np.unique(middle, axis=0, return_inverse=True)
    found = []
    for cell in range(len(cells)):
        used, corners = np.unique(mesh.triangles[number.reshape(-1) == cell], return_inverse=True)
        found.append(ColoredMesh(mesh.points[used], corners.reshape(-1, 3), mesh.colors[used]))
    return found


def _far_around(road: DrawnRoad) -> list[ColoredMesh]:
    """Meadow beyond the land, hills and sky."""
    places = np.concatenate([part.mesh.points for part in road.ground]).astype(np.float64)
    middle, floor = 0.5 * (places[:, :2].min(axis=0) + places[:, :2].max(axis=0)), float(places[:, 2].min())
    points, triangles = skirt([part for part in road.ground if part.name == "land"])
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), points.shape)
    meadow = np.column_stack([lit(np.broadcast_to(MEADOW, points.shape), up), np.ones(len(points))])
    surfaces = [Surface(points.astype(np.float32), meadow, triangles)] if len(points) else []
    surfaces += [hills(middle, radius, height, haze) for radius, height, haze in ROAD_HILLS]
    dome = sky(np.zeros(2))
    surfaces.append(Surface(_moved(dome.points * (ROAD_SKY / HORIZON), middle), dome.colors, dome.triangles))
    drop = _up(floor - SKIRT_DROP)
    lowered = [
        surface if index == 0 and len(points) else Surface(surface.points + drop, surface.colors, surface.triangles)
        for index, surface in enumerate(surfaces)
    ]
    return [_chosen(surface, np.ones(len(surface.triangles), bool)) for surface in lowered]


def _up(height: float) -> np.ndarray:
    return np.array([0.0, 0.0, height], dtype=np.float32)


def _moved(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    return (points + np.array([middle[0], middle[1], 0.0])).astype(np.float32)


def _copies(things: DrawnThings) -> list[Standing]:
    """Things that look alike, by their individual colour."""
    scales = np.linalg.norm(things.frames, axis=1)
    turns = Rotation.from_matrix(things.frames / scales[:, None]).as_quat(scalar_first=True)
    colors, number = np.unique(np.asarray(things.colors, dtype=np.float64), axis=0, return_inverse=True)
    found = []
    for index, color in enumerate(colors):
        chosen = number.reshape(-1) == index
        places = Places(*(part[chosen].astype(np.float32) for part in (things.positions, turns, scales)))
        model = glb([painted(things.parts, color)], shaded=True)
        found.append(Standing(f"{things.name}/{index}", model, places))
    return found
