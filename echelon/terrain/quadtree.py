"""The ground beneath a point: a quadtree over triangles seen from above.

A square of the map is cut into four as long as more than `LEAF_TRIANGLES` triangles meet it. The first cuts, which all
of the map needs, are one table of square cells; each entry is a node of its own quadtree:

    table, 16 m cells           a node >= 0: the first of its four children, in the order south-west, south-east,
                                north-west, north-east
    +-------+---+---+           a node < 0: leaf number -1 - node, a list of triangles
    |       | . |. .|
    |   .   +---+---+           A query goes to its cell, down to its leaf (two or three steps), and takes the first
    |       | . | . |           triangle of the list that it lies in: what is earlier in the meshes given, the road,
    +-------+---+---+           has the right of way over what is later, the land.

Heights between the corners of a triangle are smooth (see `triangulation`). Corners are float32 relative to the middle
of the map; a point is taken relative to a corner of its triangle in float64, so that a wheel kilometres away still
feels steps of a micron and less. What is outside of every triangle is level ground at the height of the nearest.

A leaf that nothing meets lists the triangle nearest to its middle; so every leaf lists at least one.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportInvalidTypeForm=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.spatial import KDTree

from echelon.terrain.triangulation import TriangleMesh

wp.set_module_options({"enable_backward": False})

LEAF_TRIANGLES = 16  # a leaf lists no more of them, unless it is as small as leaves get
TABLE_CELL = 16.0  # [m], of the first table, about
TABLE_LIMIT = 1 << 20  # cells of it, at most: a large map gets larger ones
DEEPEST = 7  # cuts below the table

_EDGE = wp.constant(-1.0e-4)  # barycentric weight down to which a point counts as on the triangle, where none has it
_OUTSIDE = wp.constant(-1.0e30)


@wp.struct
class Placement:
    """Where a triangle lies on the map: its first corner, and the matrix from there to barycentric weights.

    Attributes:
        x, y: First corner, relative to the origin [m].
        xx, xy: Weight of the second corner is xx dx + xy dy [1/m].
        yx, yy: Weight of the third corner is yx dx + yy dy [1/m].
        bulge: What smooth heights need to pass through the surface in the middle [m].
    """

    x: wp.float32
    y: wp.float32
    xx: wp.float32
    xy: wp.float32
    yx: wp.float32
    yy: wp.float32
    bulge: wp.float32


@wp.struct
class GroundTree:
    """The quadtree and its triangles as kernels see them.

    Attributes:
        roots: A node for each cell of the table, row by row,       shape [rows * columns]
        nodes: Nodes beneath them, four by four,                    shape [nodes]
        starts: Where the list of each leaf begins in `members`,    shape [leaves + 1]
        members: Triangles, ascending in each leaf,                 shape [members]
        placements: Where triangles lie,                            shape [triangles]
        corners: Points of triangles,                               shape [triangles]
        places: Of points, relative to the origin [m],              shape [points]
        shapes: Height relative to the origin [m] and gradient of points, shape [points]
        origin: Middle of the map [m].
        low, high: South-western and north-eastern corners of the map, relative to the origin [m].
        cell: Side of a cell of the table [m].
        columns, rows: Cells of the table along x and along y.
    """

    roots: wp.array[wp.int32]
    nodes: wp.array[wp.int32]
    starts: wp.array[wp.int32]
    members: wp.array[wp.int32]
    placements: wp.array[Placement]
    corners: wp.array[wp.vec3i]
    places: wp.array[wp.vec2]
    shapes: wp.array[wp.vec3]
    origin: wp.vec3d
    low: wp.vec2
    high: wp.vec2
    cell: wp.float32
    columns: wp.int32
    rows: wp.int32


# ---- asking ----------------------------------------------------------------------------------------------------------
@wp.func
def ground_leaf(ground: GroundTree, x: float, y: float) -> int:
    """The leaf of a point of the map, given relative to the origin [m]."""
    across = (x - ground.low[0]) / ground.cell
    up = (y - ground.low[1]) / ground.cell
    column = wp.clamp(int(across), 0, ground.columns - 1)
    row = wp.clamp(int(up), 0, ground.rows - 1)
    across -= float(column)
    up -= float(row)
    node = ground.roots[row * ground.columns + column]
    while node >= 0:
        across *= 2.0
        up *= 2.0
        if across >= 1.0:
            across -= 1.0
            node += 1
        if up >= 1.0:
            up -= 1.0
            node += 2
        node = ground.nodes[node]
    return -1 - node


@wp.func
def ground_weights(placement: Placement, x: wp.float64, y: wp.float64) -> wp.vec3:
    """Barycentric weights of a point, given relative to the origin [m], in a triangle."""
    dx = wp.float32(x - wp.float64(placement.x))
    dy = wp.float32(y - wp.float64(placement.y))
    second = placement.xx * dx + placement.xy * dy
    third = placement.yx * dx + placement.yy * dy
    return wp.vec3(1.0 - second - third, second, third)


@wp.func
def ground_shape(ground: GroundTree, triangle: int, weights: wp.vec3) -> wp.vec3:
    """Height relative to the origin [m] and gradient at barycentric weights, as `smooth_height` has them."""
    corner = ground.corners[triangle]
    place_a, place_b, place_c = ground.places[corner[0]], ground.places[corner[1]], ground.places[corner[2]]
    a, b, c = ground.shapes[corner[0]], ground.shapes[corner[1]], ground.shapes[corner[2]]
    ab, bc, ca = place_b - place_a, place_c - place_b, place_a - place_c
    # Bezier coefficients relative to the first corner's height, so that nothing is lost on a mountain.
    height_b, height_c = b[0] - a[0], c[0] - a[0]
    third = 1.0 / 3.0
    aab = third * (a[1] * ab[0] + a[2] * ab[1])
    aac = -third * (a[1] * ca[0] + a[2] * ca[1])
    bba = height_b - third * (b[1] * ab[0] + b[2] * ab[1])
    bbc = height_b + third * (b[1] * bc[0] + b[2] * bc[1])
    cca = height_c + third * (c[1] * ca[0] + c[2] * ca[1])
    ccb = height_c - third * (c[1] * bc[0] + c[2] * bc[1])
    abc = 0.25 * (aab + aac + bba + bbc + cca + ccb) - (height_b + height_c) / 6.0
    abc += ground.placements[triangle].bulge

    u, v, w = weights[0], weights[1], weights[2]
    rise = v * v * v * height_b + w * w * w * height_c + 6.0 * u * v * w * abc
    rise += 3.0 * (u * u * (v * aab + w * aac) + v * v * (u * bba + w * bbc) + w * w * (u * cca + v * ccb))
    return wp.vec3(a[0] + rise, u * a[1] + v * b[1] + w * c[1], u * a[2] + v * b[2] + w * c[2])


@wp.func
def ground_below(ground: GroundTree, point: wp.vec3d) -> wp.vec3:
    """Height relative to `ground.origin` [m] and gradient (dz/dx, dz/dy) of the ground below or above a point."""
    x = point[0] - ground.origin[0]
    y = point[1] - ground.origin[1]
    # Beyond the map's edge it goes on level, at the height of the edge. What is not finite ends on the edge as well.
    held_x = wp.clamp(x, wp.float64(ground.low[0]), wp.float64(ground.high[0]))
    held_y = wp.clamp(y, wp.float64(ground.low[1]), wp.float64(ground.high[1]))
    leaf = ground_leaf(ground, wp.float32(held_x), wp.float32(held_y))

    place = ground.starts[leaf]
    end = ground.starts[leaf + 1]
    nearest = float(_OUTSIDE)
    triangle = ground.members[place]
    weights = wp.vec3(1.0, 0.0, 0.0)
    while place < end:
        candidate = ground.members[place]
        found = ground_weights(ground.placements[candidate], held_x, held_y)
        least = wp.min(found[0], wp.min(found[1], found[2]))
        if least > nearest:
            nearest = least
            triangle = candidate
            weights = found
        place += 1
        if least >= 0.0:
            place = end

    if nearest < 0.0:  # in no triangle, or on an edge and rounded out of both
        weights = wp.vec3(wp.max(weights[0], 0.0), wp.max(weights[1], 0.0), wp.max(weights[2], 0.0))
        weights = weights / (weights[0] + weights[1] + weights[2])
    shape = ground_shape(ground, triangle, weights)
    if nearest < _EDGE:
        shape = wp.vec3(shape[0], 0.0, 0.0)
    if held_x != x:
        shape[1] = 0.0
    if held_y != y:
        shape[2] = 0.0
    return shape


@wp.func
def ground_plane(ground: GroundTree, point: wp.vec3d) -> wp.vec4d:
    """The ground's local plane (n_x, n_y, n_z, d) of n . x = d, in the world, below or above a point."""
    shape = ground_below(ground, point)
    x, y, z = point[0], point[1], ground.origin[2] + wp.float64(shape[0])
    normal = wp.normalize(wp.vec3d(-wp.float64(shape[1]), -wp.float64(shape[2]), wp.float64(1.0)))
    return wp.vec4d(normal[0], normal[1], normal[2], normal[0] * x + normal[1] * y + normal[2] * z)


# ---- building --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Quadtree:
    """The quadtree on the host, ready to be copied to devices; see `GroundTree` for its parts.

    Attributes:
        origin: Middle of the map [m], shape [3].
        low, high: Corners of the map, relative to the origin [m], shape [2].
        cell: Side of a cell of the table [m].
        columns, rows: Cells of the table.
        roots, nodes, starts, members: The tree.
        corners: Points of triangles, shape [triangles, 3].
        bulges: Of triangles [m], shape [triangles].
        places: Of points, relative to the origin [m], float32, shape [points, 2].
        shapes: Heights [m] and gradients of points, float32, shape [points, 3].
    """

    origin: np.ndarray
    low: np.ndarray
    high: np.ndarray
    cell: float
    columns: int
    rows: int
    roots: np.ndarray
    nodes: np.ndarray
    starts: np.ndarray
    members: np.ndarray
    corners: np.ndarray
    bulges: np.ndarray
    places: np.ndarray
    shapes: np.ndarray

    @classmethod
    def over(cls, meshes: Sequence[TriangleMesh]) -> Quadtree:
        """A quadtree over the triangles of meshes, of which the earlier have the right of way.

        Raises:
            ValueError: There are no triangles.
        """
        counts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
        corners = np.concatenate(
            [np.empty((0, 3), np.int64), *(m.triangles + n for m, n in zip(meshes, counts[:-1], strict=True))]
        )
        if not len(corners):
            raise ValueError("a quadtree needs at least one triangle")
        points = np.concatenate([mesh.points for mesh in meshes])
        gradients = np.concatenate([mesh.gradients for mesh in meshes])
        bulges = np.concatenate([np.zeros(len(m.triangles)) if m.bulges is None else m.bulges for m in meshes])
        origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
        places = (points[:, :2] - origin[:2]).astype(np.float32)
        low, high = places.min(axis=0), places.max(axis=0)
        extent = (high - low).astype(np.float64)
        cell = max(TABLE_CELL, math.sqrt(float(extent.prod()) / TABLE_LIMIT))
        columns, rows = (max(1, math.ceil(float(length) / cell)) for length in extent)
        triangles = places[corners].astype(np.float64) - low
        roots, nodes, starts, members = _tree(triangles, cell, columns, rows)
        shapes = np.column_stack([points[:, 2] - origin[2], gradients]).astype(np.float32)
        numbers = (corners.astype(np.int32), bulges, places, shapes)
        return cls(origin, low, high, cell, columns, rows, roots, nodes, starts, members, *numbers)

    def data(self, device: wp.DeviceLike = None) -> GroundTree:
        """The quadtree on a device."""

        def copied(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        ground = GroundTree()
        ground.roots, ground.nodes = copied(self.roots, wp.int32), copied(self.nodes, wp.int32)
        ground.starts, ground.members = copied(self.starts, wp.int32), copied(self.members, wp.int32)
        ground.placements = copied(_placements(self.places, self.corners, self.bulges), Placement)
        ground.corners = copied(self.corners, wp.vec3i)
        ground.places, ground.shapes = copied(self.places, wp.vec2), copied(self.shapes, wp.vec3)
        ground.origin = wp.vec3d(*self.origin.tolist())
        ground.low, ground.high = wp.vec2(*self.low.tolist()), wp.vec2(*self.high.tolist())
        ground.cell = self.cell
        ground.columns, ground.rows = self.columns, self.rows
        return ground


def _placements(places: np.ndarray, corners: np.ndarray, bulges: np.ndarray) -> np.ndarray:
    """`Placement`s of triangles as a structured array."""
    a, b, c = (places[corners[:, k]].astype(np.float64) for k in range(3))
    ab, ac = b - a, c - a
    determinant = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    placements = np.zeros(len(corners), dtype=Placement.numpy_dtype())
    placements["x"], placements["y"] = a[:, 0], a[:, 1]
    placements["xx"], placements["xy"] = ac[:, 1] / determinant, -ac[:, 0] / determinant
    placements["yx"], placements["yy"] = -ab[:, 1] / determinant, ab[:, 0] / determinant
    placements["bulge"] = bulges
    return placements


def _tree(
    triangles: np.ndarray, cell: float, columns: int, rows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(roots, nodes, starts, members) of triangles given relative to the table's corner, shape [triangles, 3, 2].

    Level by level: `of` and `which` are pairs of a square and a triangle that meet, sorted by both; a square is known
    by its middle (x, y).
    """
    outlines = _Outlines(triangles)
    x, y = np.tile(np.arange(columns) + 0.5, rows) * cell, np.repeat(np.arange(rows) + 0.5, columns) * cell
    of, which = _table_pairs(triangles, cell, columns, rows)
    met = outlines.meet(which, x[of], y[of], 0.5 * cell)
    of, which = of[met], which[met]
    half = 0.5 * cell
    levels: list[np.ndarray] = []  # of each square: 1 + its place among those of its level that are cut, or 0
    leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []  # per level: (squares, pairs' squares, triangles)
    middles: list[np.ndarray] = []  # per level: of the leaves' squares
    for depth in range(DEEPEST + 1):
        counts = np.bincount(of, minlength=len(x))
        cut = counts > (LEAF_TRIANGLES if depth < DEEPEST else len(triangles))
        levels.append(np.where(cut, np.cumsum(cut), 0))
        kept = ~cut[of]
        leaves.append((np.flatnonzero(~cut), of[kept], which[kept]))
        middles.append(np.stack([x[~cut], y[~cut]], axis=1))
        if not cut.any():
            break
        half *= 0.5
        x = (x[cut][:, None] + half * np.array([-1, 1, -1, 1])).ravel()
        y = (y[cut][:, None] + half * np.array([-1, -1, 1, 1])).ravel()
        of = (4 * (levels[-1][of[~kept]] - 1)[:, None] + np.arange(4)).ravel()
        which = np.repeat(which[~kept], 4)
        met = outlines.meet(which, x[of], y[of], half)
        # Sorted by square; within one the triangles are in order already.
        met = met[np.argsort(of[met], kind="stable")]
        of, which = of[met], which[met]
    return _joined(levels, leaves, middles, triangles)


def _joined(
    levels: list[np.ndarray],
    leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    middles: list[np.ndarray],
    triangles: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Levels of squares as one array of nodes, and their leaves as lists."""
    tree = KDTree(triangles.mean(axis=1))
    first_node = np.cumsum([0, *(len(level) for level in levels[1:])])  # the table's squares are no nodes
    lists: list[np.ndarray] = []
    counts: list[np.ndarray] = []
    coded: list[np.ndarray] = []
    leaf_count = 0
    for depth, (level, (squares, of, which), middle) in enumerate(zip(levels, leaves, middles, strict=True)):
        number = np.searchsorted(squares, of)
        count = np.bincount(number, minlength=len(squares))
        empty = np.flatnonzero(count == 0)
        nearest = np.asarray(tree.query(middle[empty])[1], dtype=np.int64)
        owners, members = np.concatenate([number, empty]), np.concatenate([which, nearest])
        lists.append(members[np.argsort(owners, kind="stable")])
        counts.append(np.maximum(count, 1))
        codes = first_node[depth] + 4 * (level - 1)
        codes[squares] = -1 - (leaf_count + np.arange(len(squares)))
        coded.append(codes)
        leaf_count += len(squares)
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    nodes = np.concatenate([*coded[1:], np.zeros(0, dtype=np.int64)])
    parts = (coded[0], nodes, starts, np.concatenate(lists))
    roots, nodes, starts, members = (part.astype(np.int32) for part in parts)
    return roots, nodes, starts, members


def _table_pairs(triangles: np.ndarray, cell: float, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (cell of the table, triangle) of which the triangle's box meets the cell, sorted by both."""
    limits = np.array([columns, rows]) - 1
    low = np.clip(np.floor(triangles.min(axis=1) / cell - 1e-4).astype(np.int64), 0, limits)
    high = np.clip(np.floor(triangles.max(axis=1) / cell + 1e-4).astype(np.int64), 0, limits)
    wide = high - low + 1
    count = wide.prod(axis=1)
    which = np.repeat(np.arange(len(triangles)), count)
    within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    column = low[which, 0] + within % wide[which, 0]
    row = low[which, 1] + within // wide[which, 0]
    of = row * columns + column
    order = np.argsort(of, kind="stable")
    return of[order], which[order]


class _Outlines:
    """Triangles as what squares are tested against, a row of numbers for each test and triangle."""

    def __init__(self, triangles: np.ndarray):
        """Prepare triangles, counter-clockwise, relative to the table's corner [m], shape [triangles, 3, 2]."""
        x, y = np.ascontiguousarray(triangles[..., 0].T), np.ascontiguousarray(triangles[..., 1].T)
        self.low_x, self.high_x, self.low_y, self.high_y = x.min(axis=0), x.max(axis=0), y.min(axis=0), y.max(axis=0)
        along_x, along_y = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y
        # Inside of an edge is where n . p >= d; a square of half a side h reaches h (|n_x| + |n_y|) farther.
        self.normal_x, self.normal_y = -along_y, along_x
        self.distance = self.normal_x * x + self.normal_y * y
        self.reach = np.abs(along_x) + np.abs(along_y)

    def meet(self, which: np.ndarray, x: np.ndarray, y: np.ndarray, half: float) -> np.ndarray:
        """Indices of the pairs of a triangle and a square that no axis and no edge separates; touching counts.

        Args:
            which: Triangles, shape [pairs].
            x, y: Middles of squares [m], shape [pairs].
            half: Half their side [m].
        """
        half *= 1.0 + 2e-4  # a kernel finds the square in float32
        pairs = np.flatnonzero(
            (self.low_x[which] <= x + half)
            & (self.high_x[which] >= x - half)
            & (self.low_y[which] <= y + half)
            & (self.high_y[which] >= y - half)
        )
        which, x, y = which[pairs], x[pairs], y[pairs]
        inside = np.ones(len(pairs), dtype=bool)
        for normal_x, normal_y, distance, reach in zip(
            self.normal_x, self.normal_y, self.distance, self.reach, strict=True
        ):
            inside &= normal_x[which] * x + normal_y[which] * y + half * reach[which] >= distance[which]
        return pairs[inside]
