"""Walls: fences as line segments, what is nearest to a point, and the set pieces of a world as plain data.

A wall is a segment on the ground, a `wp.vec4` (x0, y0, x1, y1); a fence is a polyline of them. Two ways to ask:

* `nearest_wall` goes through all of them: any distance, a few dozen walls.
* `walls_of_cell` with a `WallGrid`, made once by `wall_grid`: the short list of the walls within `reach` of the cell
  of a point, empty for most points of a large field. What runs for every agent in every frame asks this way.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from echelon.scenario import WorldSettings
from echelon.settings import plain

wp.set_module_options({"enable_backward": False})

COLUMN_SIDES = 16  # of the polygon that stands for a column
HALF_CIRCLE_SEGMENTS = 24  # of the infield's fence: chords within 0.06 m of a circle of 28 m radius
SURFACE_WALL = wp.constant(1)  # of contact sites that meet walls; all others meet the ground
NOWHERE = wp.constant(wp.float64(-1.0e6))  # [m], offset of a plane that nothing reaches
NO_WALL = wp.constant(1.0e15)  # [m], the distance to the nearest wall where there is none; its square is a float32

_CELL_LIMIT = 1 << 20  # cells of a wall grid, at most: a large field gets larger cells, not more memory


@dataclass(frozen=True)
class Fence:
    """A fence of straight pieces between posts.

    Attributes:
        name: What it encloses.
        points: Its posts (x, y) in order [m].
        closed: Whether a last piece joins the last post to the first.
        height: [m].
    """

    name: str
    points: tuple[tuple[float, float], ...]
    closed: bool
    height: float

    def segments(self) -> np.ndarray:
        """Its pieces as rows (x0, y0, x1, y1) [m], shape [pieces, 4]."""
        posts = np.array(self.points, dtype=np.float64)
        ends = np.roll(posts, -1, axis=0)
        return np.hstack([posts, ends])[: len(posts) if self.closed else len(posts) - 1]


# ---- set pieces ------------------------------------------------------------------------------------------------------
def infield_walls(world: WorldSettings) -> tuple[Fence, ...]:
    """The fences of a world, those there are: the infield's, counter-clockwise, the corral's, the gap's, all others."""
    found: list[Fence] = []
    if world.ground == "oval":
        outline = _stadium(world.half_length, world.half_width)
        found.append(Fence("infield", outline, closed=True, height=world.fence_height))
    if world.corral is not None:
        found.append(Fence("corral", world.corral.fences(), closed=False, height=world.fence_height))
    if world.gap is not None:
        for name, ends in zip(("gap_left", "gap_right"), world.gap.fences(), strict=True):
            found.append(Fence(name, ends, closed=False, height=world.fence_height))
    for index, wall in enumerate(world.walls):
        found.append(Fence(f"wall_{index + 1}", wall.points, closed=wall.closed, height=wall.height))
    return tuple(found)


def column_segments(world: WorldSettings) -> np.ndarray:
    """The columns as polygons around them, as float32 rows (x0, y0, x1, y1) [m], shape [pieces, 4].

    A polygon lies outside of its circle, by a fiftieth of the radius at its corners, so that what stops at it has not
    yet entered what is drawn.
    """
    columns = world.all_columns()
    angle = 2.0 * math.pi * np.arange(COLUMN_SIDES) / COLUMN_SIDES
    around = np.column_stack([np.cos(angle), np.sin(angle)]) / math.cos(math.pi / COLUMN_SIDES)
    corners = columns[:, None, :2] + columns[:, None, 2:] * around
    rows = np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=2)
    return rows.reshape(-1, 4).astype(np.float32)


def wall_segments(world: WorldSettings) -> np.ndarray:
    """All that stops a body: the pieces of fences, then of columns, float32 [m], shape [pieces, 4]."""
    return np.vstack([segments(infield_walls(world)), column_segments(world)])


def segments(of: Iterable[Fence]) -> np.ndarray:
    """All pieces of several fences, in order, as float32 rows (x0, y0, x1, y1) [m], shape [pieces, 4]."""
    rows = [fence.segments() for fence in of]
    return np.vstack([np.empty((0, 4)), *rows]).astype(np.float32)


def wall_array(world: WorldSettings, device: wp.DeviceLike = None) -> wp.array[wp.vec4]:
    """The walls of a world on a device [m], shape [pieces], for `nearest_wall`."""
    return wp.array(wall_segments(world), dtype=wp.vec4, device=device)


def world_dict(world: WorldSettings) -> dict[str, Any]:
    """The set pieces as plain data, as recordings carry them: ground, walls, corral and columns if there are any."""
    if world.ground == "oval":
        ground = {"shape": "oval", "half_length": world.half_length, "half_width": world.half_width}
    elif world.ground == "mat":
        ground = {"shape": "mat", "half_length": world.half_length, "half_width": world.half_width}
    else:
        ground = {"shape": world.ground, "half_size": world.half_length}
    data: dict[str, Any] = {
        "ground": ground,
        "walls": [
            {"name": f.name, "points": [list(point) for point in f.points], "closed": f.closed, "height": f.height}
            for f in infield_walls(world)
        ],
    }
    if world.corral is not None:
        data["corral"] = {
            "center": list(world.corral.center),
            "size": world.corral.size,
            "opening": world.corral.opening,
            "facing": list(world.corral.facing),
        }
    if world.platform is not None:
        data["platform"] = plain(world.platform)
    columns = world.all_columns()
    if len(columns):
        data["columns"] = [
            {"center": [x, y], "radius": r, "height": world.column_height} for x, y, r in columns.tolist()
        ]
    return data


def _stadium(half_length: float, half_width: float) -> tuple[tuple[float, float], ...]:
    """Two half circles joined by straight sides, counter-clockwise from (straight, -half_width) [m]."""
    straight = half_length - half_width
    points: list[tuple[float, float]] = []
    for side, start in ((1.0, -0.5 * math.pi), (-1.0, 0.5 * math.pi)):
        for step in range(HALF_CIRCLE_SEGMENTS + 1):
            angle = start + math.pi * step / HALF_CIRCLE_SEGMENTS
            points.append((side * straight + half_width * math.cos(angle), half_width * math.sin(angle)))
    if straight == 0.0:  # the half circles share their ends
        del points[-1], points[HALF_CIRCLE_SEGMENTS]
    return tuple(points)


# ---- all walls -------------------------------------------------------------------------------------------------------
@wp.func
def closest_on_wall(point: wp.vec2, wall: wp.vec4) -> wp.vec2:
    """The point of a wall that is nearest to `point` [m]."""
    start = wp.vec2(wall[0], wall[1])
    along = wp.vec2(wall[2] - wall[0], wall[3] - wall[1])
    length_sq = wp.dot(along, along)
    part = wp.float32(0.0)
    if length_sq > 0.0:
        part = wp.clamp(wp.dot(point - start, along) / length_sq, 0.0, 1.0)
    return start + part * along


@wp.func
def nearest_wall(point: wp.vec2, walls: wp.array[wp.vec4]) -> wp.vec4:
    """Where the nearest wall is nearest to `point`.

    Returns (x, y, distance [m], index of the wall as a float); where there are no walls, `point` itself, `NO_WALL`, -1.
    Of walls equally near, the first.
    """
    best_sq = float(NO_WALL * NO_WALL)
    best = wp.float32(-1.0)
    best_point = point
    for index in range(walls.shape[0]):
        candidate = closest_on_wall(point, walls[index])
        gap = candidate - point
        distance_sq = wp.dot(gap, gap)
        if distance_sq < best_sq:
            best_sq = distance_sq
            best = float(index)
            best_point = candidate
    return wp.vec4(best_point[0], best_point[1], wp.sqrt(best_sq), best)


# ---- walls near a point ----------------------------------------------------------------------------------------------
@wp.struct
class WallGrid:
    """For every cell of a rectangle, the walls within reach of any of its points; outside of it there are none.

    Attributes:
        walls: (x0, y0, x1, y1) [m], shape [walls].
        starts: Where the list of each cell begins in `members`, row by row, shape [rows * columns + 1].
        members: Indices of walls, ascending in each cell.
        origin: Lower corner of the rectangle [m].
        cell_size: [m].
        columns, rows: Cells along x and along y.
        reach: A list holds all walls nearer than this to any point of its cell [m].
    """

    walls: wp.array[wp.vec4]
    starts: wp.array[wp.int32]
    members: wp.array[wp.int32]
    origin: wp.vec2
    cell_size: wp.float32
    columns: wp.int32
    rows: wp.int32
    reach: wp.float32


def wall_grid(world: WorldSettings, reach: float, device: wp.DeviceLike = None) -> WallGrid:
    """The walls of a world, ready to be asked what is within `reach` [m] of a point."""
    return grid_of_walls(wall_segments(world), reach, device)


def grid_of_walls(walls: np.ndarray, reach: float, device: wp.DeviceLike = None) -> WallGrid:
    """Walls, ready to be asked what is within `reach` [m] of a point.

    Args:
        walls: Rows (x0, y0, x1, y1) [m], float32, shape [walls, 4].
        reach: How far from a point walls are found [m].
        device: Where they are asked for.
    """
    low, high = np.zeros(2), np.zeros(2)
    if len(walls):
        ends = walls.reshape(-1, 2)
        low, high = ends.min(axis=0) - reach, ends.max(axis=0) + reach
    extent = high - low
    cell_size = max(1.0, 0.5 * reach, math.sqrt(float(extent.prod()) / _CELL_LIMIT))
    columns, rows = (max(1, math.ceil(float(length) / cell_size)) for length in extent)
    starts, members = _cell_lists(walls.astype(np.float64), low, cell_size, columns, rows, reach)

    grid = WallGrid()
    grid.walls = wp.array(walls, dtype=wp.vec4, device=device)
    grid.starts = wp.array(starts, dtype=wp.int32, device=device)
    grid.members = wp.array(members, dtype=wp.int32, device=device)
    grid.origin = wp.vec2(*low.tolist())
    grid.cell_size = cell_size
    grid.columns, grid.rows = columns, rows
    grid.reach = reach
    return grid


def _cell_lists(
    walls: np.ndarray, low: np.ndarray, cell_size: float, columns: int, rows: int, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Starts and members of a `WallGrid`: a wall belongs to the cells whose circumcircle, widened, it meets."""
    x = low[0] + cell_size * (np.arange(columns) + 0.5)
    y = low[1] + cell_size * (np.arange(rows) + 0.5)
    centers = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    # A thousandth more than half the diagonal: the cell of a point on an edge is found in float32.
    limit = reach + 0.708 * cell_size
    cells: list[np.ndarray] = []
    for wall in walls:
        start, along = wall[:2], wall[2:] - wall[:2]
        length_sq = float(along @ along)
        part = np.clip((centers - start) @ along / length_sq, 0.0, 1.0) if length_sq else np.zeros(len(centers))
        gaps = np.linalg.norm(start + part[:, None] * along - centers, axis=1)
        cells.append(np.flatnonzero(gaps < limit))
    counts = np.zeros(len(centers) + 1, dtype=np.int64)
    owners = np.concatenate([np.empty(0, dtype=np.int64), *cells])
    indices = np.repeat(np.arange(len(walls)), [len(found) for found in cells])
    np.add.at(counts, owners + 1, 1)
    return np.cumsum(counts).astype(np.int32), indices[np.argsort(owners, kind="stable")].astype(np.int32)


@wp.func
def walls_of_cell(point: wp.vec2, grid: WallGrid) -> wp.vec2i:
    """First and one past the last place in `grid.members` of the walls that may be within `grid.reach` of `point`."""
    place = (point - grid.origin) / grid.cell_size
    # Compared as floats: a coordinate that is not finite, or beyond what an integer holds, is outside as well.
    if place[0] >= 0.0 and place[1] >= 0.0 and place[0] < wp.float32(grid.columns) and place[1] < wp.float32(grid.rows):
        cell = int(place[1]) * grid.columns + int(place[0])
        return wp.vec2i(grid.starts[cell], grid.starts[cell + 1])
    return wp.vec2i(0, 0)


@wp.func
def nearest_wall_within(point: wp.vec2, grid: WallGrid) -> wp.vec4:
    """`nearest_wall` for walls nearer than `grid.reach`: a wall farther away may be passed over."""
    best_sq = float(NO_WALL * NO_WALL)
    best = wp.float32(-1.0)
    best_point = point
    places = walls_of_cell(point, grid)
    for place in range(places[0], places[1]):
        index = grid.members[place]
        candidate = closest_on_wall(point, grid.walls[index])
        gap = candidate - point
        distance_sq = wp.dot(gap, gap)
        if distance_sq < best_sq:
            best_sq = distance_sq
            best = float(index)
            best_point = candidate
    return wp.vec4(best_point[0], best_point[1], wp.sqrt(best_sq), best)


@wp.func
def wall_plane(point: wp.vec3d, grid: WallGrid) -> wp.vec4d:
    """The upright plane (n_x, n_y, 0, d) of n . x = d, in the world, of the nearest wall, towards the point's side."""
    flat = wp.vec2(wp.float32(point[0]), wp.float32(point[1]))
    hit = nearest_wall_within(flat, grid)
    away = flat - wp.vec2(hit[0], hit[1])
    distance = wp.length(away)
    # On the wall itself there is no telling which side is the inside: wait for the next look.
    if hit[3] < 0.0 or distance < 1.0e-4:
        return wp.vec4d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0), NOWHERE)
    n_x, n_y = wp.float64(away[0] / distance), wp.float64(away[1] / distance)
    return wp.vec4d(n_x, n_y, wp.float64(0.0), n_x * wp.float64(hit[0]) + n_y * wp.float64(hit[1]))
