"""A road and the land around it as two NURBS surfaces, and as the ground that wheels feel.

*The land* is the bicubic surface through a grid of heights. *The road* is the bicubic surface through sections across
the road's strip (see `strip`): along it go the centreline's heights, across it lie asphalt, verge and shoulder, and at
its outer edges it is the land. Where the strip is, the road is the ground; elsewhere the land is, and beyond the land's
edge the ground goes on level.

`RoadTerrain` is what a simulation asks: both surfaces cut into smooth triangles, in a quadtree.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import warp as wp

from echelon.errors import InputError
from echelon.terrain.adaptive_triangulation import triangulate_adaptively
from echelon.terrain.nurbs import NurbsSurface
from echelon.terrain.quadtree import GroundTree, Quadtree, ground_plane
from echelon.terrain.spline import Centreline
from echelon.terrain.strip import HeightOf, RoadStrip
from echelon.terrain.triangulation import triangulate
from echelon.terrain.walls import SURFACE_WALL, WallGrid, grid_of_walls, wall_plane

wp.set_module_options({"enable_backward": False})

ROAD_TOLERANCE = 0.002
"""How far the triangles that wheels feel may be off the road's surface [m]."""

LAND_TOLERANCE = 0.005
"""How far they may be off the land's [m]."""

LAND_SPACING = 10.0  # [m] between the heights that the land goes through, at least
LAND_HEIGHTS = 60_000  # of them, at most: a large land gets fewer a hectare
WALL_REACH = 2.0  # [m]; walls nearer than this to a body are found

_LEVEL_STEP = 1.5  # [m] across asphalt and verge, at most
_CLOSE_LEVEL_STEP = 0.75  # [m], of a road that meets itself: another stretch may end upon it
_SHOULDER_STEPS = 6
_ROAD_CELL = 8.0  # [m] along the road, of triangles to begin with
_OUTLINE = 0.1  # [m] from the strip's limit to the edges of its outer triangles
_LAND_CELL = 4.0  # spacings of the land's heights, of triangles to begin with


class RoadSurfaces:
    """The surface of a road, and that of the land around it.

    Attributes:
        centreline: Of the road.
        half_width: From the centreline to the edge of the asphalt [m].
        strip: The ground that belongs to the road.
        road: u runs across the strip from its left edge, 0, to its right, 1; v is the arc length [m].
        land: u is x and v is y [m].
    """

    def __init__(
        self,
        centreline: Centreline,
        half_width: float,
        verge: float,
        land: HeightOf,
        *,
        shoulder: float = 4.0,
        bank: float = 0.0,
        land_margin: float = 150.0,
        land_spacing: float = LAND_SPACING,
    ):
        """Lay the surfaces.

        Args:
            centreline: Of the road.
            half_width: From the centreline to the edge of the asphalt [m].
            verge: Ground beside the asphalt that is level with it [m].
            land: Heights [m] of the land at places (x, y) [m], shape [..., 2] to [...]; near the road about the road's.
            shoulder: Beyond the verge, over which the road's height becomes the land's [m].
            bank: Greatest slope across the road in bends, the inner side lower (0.05: 5 cm a metre).
            land_margin: How far the land reaches beyond the road [m].
            land_spacing: Between the heights that the land goes through [m]; a large land has larger ones.

        Raises:
            InputError: A size that is not positive, or heights that are not finite.
        """
        sizes = {"half_width": half_width, "shoulder": shoulder, "land_spacing": land_spacing}
        for name, value in sizes.items():
            if not value > 0.0:
                raise InputError(f"road: {name} is {value:g}; it must be greater than 0")
        for name, value in {"verge": verge, "land_margin": land_margin}.items():
            if not value >= 0.0:
                raise InputError(f"road: {name} is {value:g}; it must be at least 0")
        if not 0.0 <= bank <= 0.3:
            raise InputError(f"road: bank is {bank:g}; it must be from 0 to 0.3")
        self.centreline = centreline
        self.half_width = half_width
        self.strip = RoadStrip(centreline, half_width, verge, shoulder, bank)
        self.land = _land_surface(self.strip, land, land_margin, land_spacing)
        self.road = self._road_surface()

    def _road_surface(self) -> NurbsSurface:
        """The surface through sections of the strip."""
        strip = self.strip
        s = strip.sections()
        columns, _ = self._columns
        sections = s[:-1] if self.centreline.closed else s
        offset = self.offset_at(columns[:, None], sections)
        flat = strip.centreline.position(sections)[:, :2] + offset[..., None] * strip.centreline.left(sections)
        alone = ~strip.meets(sections)
        land = self.land_height(flat.reshape(-1, 2)).reshape(offset.shape)
        share = strip.share(sections, offset)
        heights = land + share * (strip.height(sections, offset) - land)
        if not alone.all():
            shared = flat[:, ~alone].reshape(-1, 2)
            blended = strip.blended(shared, land[:, ~alone].ravel(), strip.feet(shared))
            heights[:, ~alone] = blended.reshape(len(columns), -1)
        points = np.concatenate([flat, heights[..., None]], axis=-1)
        return NurbsSurface.through(points, columns, s, closed_v=self.centreline.closed)

    # ---- across the strip --------------------------------------------------------------------------------------------
    @cached_property
    def _columns(self) -> tuple[np.ndarray, tuple[float, float]]:
        """Parameters u of the columns, and those at which the level part begins and ends."""
        strip = self.strip
        step = _CLOSE_LEVEL_STEP if strip.meets_itself else _LEVEL_STEP
        steps = 2 * max(2, int(np.ceil(strip.level / step)))
        level = np.linspace(strip.level, -strip.level, steps + 1)
        shoulder = np.linspace(strip.limit, strip.level, _SHOULDER_STEPS + 1)[:-1]
        offsets = np.concatenate([shoulder, level, -shoulder[::-1]])
        u = 0.5 - 0.5 * offsets / strip.limit
        return u, (float(u[_SHOULDER_STEPS]), float(u[_SHOULDER_STEPS + steps]))

    def offset_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Offset from the centreline of parameter u across the strip [m], left positive, shape [...]."""
        first, last = self._columns[1]
        (left, right), (level_left, level_right) = self.strip.limits(s), self.strip.levels(s)
        level = np.where(u < 0.5, level_left * (0.5 - u) / (0.5 - first), level_right * (0.5 - u) / (last - 0.5))
        outer_left = level_left + (left - level_left) * (first - u) / first
        outer_right = -level_right - (right - level_right) * (u - last) / (1.0 - last)
        return np.where(u < first, outer_left, np.where(u > last, outer_right, level))

    def parameter_at(self, offset: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Parameter u across the strip of an offset [m], the inverse of `offset_at`, shape [...]."""
        first, last = self._columns[1]
        (left, right), (level_left, level_right) = self.strip.limits(s), self.strip.levels(s)
        level = np.where(
            offset > 0.0, 0.5 - (0.5 - first) * offset / level_left, 0.5 - (last - 0.5) * offset / level_right
        )
        outer_left = first * (left - offset) / (left - level_left)
        outer_right = last + (1.0 - last) * (-offset - level_right) / (right - level_right)
        u = np.where(offset > level_left, outer_left, np.where(offset < -level_right, outer_right, level))
        return np.clip(u, 0.0, 1.0)

    def road_point(self, s: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """The point of the road's surface at an arc length and an offset [m], shape [..., 3]."""
        s, offset = np.broadcast_arrays(s, offset)
        v = np.mod(s, self.centreline.length) if self.centreline.closed else np.clip(s, *self.road.range_v)
        return self.road.point(self.parameter_at(offset, s), v)

    # ---- anywhere ----------------------------------------------------------------------------------------------------
    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height of the ground at places on the map [m], shape [..., 2] to [...]."""
        return self._heights_and_normals(xy)[0]

    def normal(self, xy: np.ndarray) -> np.ndarray:
        """Unit normal of the ground at places on the map [m], shape [..., 2] to [..., 3]."""
        return self._heights_and_normals(xy)[1]

    def on_road(self, xy: np.ndarray) -> np.ndarray:
        """Whether places on the map [m], shape [..., 2], are on the asphalt, shape [...]."""
        s, offset = self.centreline.closest(xy)
        inside = np.abs(offset) <= self.half_width
        return inside if self.centreline.closed else inside & (s >= 0.0) & (s <= self.centreline.length)

    def land_height(self, xy: np.ndarray) -> np.ndarray:
        """Height of the land, road or none [m], shape [..., 2] to [...]."""
        x, y = self._held(np.asarray(xy, dtype=np.float64))
        return self.land.point(x, y)[..., 2]

    def _held(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places held within the land."""
        return np.clip(xy[..., 0], *self.land.range_u), np.clip(xy[..., 1], *self.land.range_v)

    def _heights_and_normals(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        places = np.asarray(xy, dtype=np.float64)
        flat = places.reshape(-1, 2)
        x, y = self._held(flat)
        heights, normals = self.land.point(x, y)[:, 2], self.land.normal(x, y)
        # Beyond the land the ground is level in the direction in which it left it.
        slopes = np.stack([normals[:, 0] * (x == flat[:, 0]), normals[:, 1] * (y == flat[:, 1]), normals[:, 2]], axis=1)
        normals = slopes / np.linalg.norm(slopes, axis=1, keepdims=True)

        feet = self.strip.feet(flat)
        order = np.lexsort((np.abs(feet.offset), feet.place))
        nearest = order[np.unique(feet.place[order], return_index=True)[1]]
        place, s, offset = feet.place[nearest], feet.s[nearest], feet.offset[nearest]
        u, v = self.road.parameters_at(flat[place], self.parameter_at(offset, s), s)
        points = self.road.point(u, v)
        reached = np.linalg.norm(points[:, :2] - flat[place], axis=1) < 1.0e-6
        heights[place[reached]] = points[reached, 2]
        normals[place[reached]] = self.road.normal(u[reached], v[reached])
        return heights.reshape(places.shape[:-1]), normals.reshape(*places.shape[:-1], 3)

    # ---- as triangles ------------------------------------------------------------------------------------------------
    @cached_property
    def quadtree(self) -> Quadtree:
        """What wheels feel: both surfaces within their tolerances, the road with the right of way."""
        first, last = self._columns[1]
        u = np.array([0.0, 0.5 * first, first, 0.5, last, 0.5 + 0.5 * last, 1.0])
        cells = max(4, int(np.ceil((self.strip.end - self.strip.start) / _ROAD_CELL)))
        v = np.linspace(self.strip.start, self.strip.end, cells + 1)
        road = triangulate(self.road, ROAD_TOLERANCE, smooth=True, outline=_OUTLINE, name="road", u=u, v=v)
        x, y = (
            np.linspace(low, high, max(1, round((high - low) / (_LAND_CELL * spacing))) + 1)
            for (low, high), spacing in (
                (self.land.range_u, self.land.knots_u[5] - self.land.knots_u[4]),
                (self.land.range_v, self.land.knots_v[5] - self.land.knots_v[4]),
            )
        )
        return Quadtree.over([road, triangulate_adaptively(self.land, LAND_TOLERANCE, x, y, "land")])


def _land_surface(strip: RoadStrip, land: HeightOf, margin: float, spacing: float) -> NurbsSurface:
    """The surface through the land's heights on a grid around the road."""
    line = strip.centreline.position(np.arange(strip.start, strip.end, 2.0))[:, :2]
    low, high = line.min(axis=0) - strip.limit - margin, line.max(axis=0) + strip.limit + margin
    spacing = max(spacing, float(np.sqrt((high - low).prod() / LAND_HEIGHTS)))
    x, y = (np.linspace(a, b, max(8, int(np.ceil((b - a) / spacing))) + 1) for a, b in zip(low, high, strict=True))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    heights = np.asarray(land(places), dtype=np.float64)
    if heights.shape != places.shape[:2] or not np.isfinite(heights).all():
        raise InputError("road: the land's heights must be one finite number for each place")
    return NurbsSurface.through(np.concatenate([places, heights[..., None]], axis=-1), x, y)


# ---- for the simulation ----------------------------------------------------------------------------------------------
@wp.struct
class RoadGround:
    """What `look_up_road` reads: the ground, and walls that stand on it."""

    ground: GroundTree
    walls: WallGrid


@wp.func
def look_up_road(surface: int, point: wp.vec3d, data: RoadGround) -> wp.vec4d:
    """The local plane (n_x, n_y, n_z, d) of n . x = d, in the world, that a site of this surface at `point` meets."""
    if surface == SURFACE_WALL:
        return wall_plane(point, data.walls)
    return ground_plane(data.ground, point)


class HasSurfaces(Protocol):
    """What has a road, as courses have."""

    @property
    def surfaces(self) -> RoadSurfaces:
        """The surface of the road, and that of the land."""
        ...


@dataclass(frozen=True)
class RoadTerrain:
    """A road, the land around it and the walls upon it, on a device.

    Attributes:
        data: What `look_up` reads.
        look_up: The Warp function that gives a site its local plane.
        level: Whether the ground's normal is +z everywhere; it is not.
        rough: Whether planes change within a frame; they do.
    """

    data: Any
    look_up: Any = look_up_road
    level: bool = False
    rough: bool = True

    @classmethod
    def of(
        cls,
        source: RoadSurfaces | HasSurfaces,
        device: wp.DeviceLike = None,
        obstacles: Sequence[Sequence[float]] | np.ndarray = (),
    ) -> RoadTerrain:
        """The terrain of a road or a course.

        Args:
            source: Surfaces, or what has them.
            device: Where it is asked.
            obstacles: Walls that bodies meet, rows (x0, y0, x1, y1) [m], shape [walls, 4].
        """
        surfaces = source if isinstance(source, RoadSurfaces) else source.surfaces
        data = RoadGround()
        data.ground = surfaces.quadtree.data(device)
        walls = np.asarray(obstacles, dtype=np.float32).reshape(-1, 4)
        data.walls = grid_of_walls(walls, WALL_REACH, device)
        return cls(data)
