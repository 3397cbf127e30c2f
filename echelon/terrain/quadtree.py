"""The ground beneath a point: a quadtree over triangles seen from above.

A square of the map is cut into four as long as more than `LEAF_TRIANGLES` triangles meet it. The first cuts, which all
of the map needs, are one table of square cells; each entry is a node of its own quadtree:

    table, 16 m cells           a node >= 0: the first of its four children, in the order south-west, south-east,
                                north-west, north-east
    +-------+---+---+           a node < 0: a leaf, whose list begins at -1 - node: how many, then which triangles
    |       | . |. .|
    |   .   +---+---+           A query goes to its cell, down to its leaf (two or three steps), and takes the first
    |       | . | . |           triangle of the list that it lies in: what is earlier in the meshes given, the road,
    +-------+---+---+           has the right of way over what is later, the land.

Heights between the corners of a triangle are smooth (see `triangulation`). Corners are float32 relative to the middle
of the map; a point is taken relative to a corner of its triangle in float64, so that a wheel kilometres away still
feels steps of a micron and less. What is outside of every triangle is level ground at the height of the nearest.

A leaf that nothing meets lists the triangle nearest to its middle; so every leaf lists at least one. Leaves, triangles
and points are numbered along the map, so that what is near one another is so in memory: a query at random mostly waits
for memory, and so asks for few lines of it.
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

_INSIDE = wp.constant(-1.0e-5)  # barycentric weight down to which a point is in a triangle: on an edge it may round out
_EDGE = wp.constant(-1.0e-4)  # barycentric weight down to which a point counts as on the triangle, where none has it
_OUTSIDE = wp.constant(-1.0e30)


@wp.struct
class Placement:
    """A triangle: where it lies on the map, as its first corner and the matrix from there to barycentric weights.

    Attributes:
        x, y: First corner, relative to the origin [m].
        xx, xy: Weight of the second corner is xx dx + xy dy [1/m].
        yx, yy: Weight of the third corner is yx dx + yy dy [1/m].
        bulge: What smooth heights need to pass through the surface in the middle [m].
        a, b, c: Its corners.
    """

    x: wp.float32
    y: wp.float32
    xx: wp.float32
    xy: wp.float32
    yx: wp.float32
    yy: wp.float32
    bulge: wp.float32
    a: wp.int32
    b: wp.int32
    c: wp.int32


@wp.struct
class GroundPoint:
    """A corner of triangles.

    Attributes:
        x, y, z: Relative to the origin [m].
        slope_x, slope_y: dz/dx and dz/dy.
    """

    x: wp.float32
    y: wp.float32
    z: wp.float32
    slope_x: wp.float32
    slope_y: wp.float32


@wp.struct
class GroundTree:
    """The quadtree and its triangles as kernels see them.

    Attributes:
        roots: A node for each cell of the table, row by row,  shape [rows * columns]
        nodes: Nodes beneath them, four by four,               shape [nodes]
        lists: Of each leaf how many triangles and which,      shape [leaves + members]
        placements: Where triangles lie,                       shape [triangles]
        points: Corners,                                       shape [points]
        origin: Middle of the map [m].
        low, high: South-western and north-eastern corners of the map, relative to the origin [m].
        cell: Side of a cell of the table [m].
        columns, rows: Cells of the table along x and along y.
    """

    roots: wp.array[wp.int32]
    nodes: wp.array[wp.int32]
    lists: wp.array[wp.int32]
    placements: wp.array[Placement]
    points: wp.array[GroundPoint]
    origin: wp.vec3d
    low: wp.vec2
    high: wp.vec2
    cell: wp.float32
    columns: wp.int32
    rows: wp.int32


# ---- asking ----------------------------------------------------------------------------------------------------------
@wp.func
def ground_leaf(ground: GroundTree, x: float, y: float) -> int:
    """Where the list begins of the leaf of a point of the map, given relative to the origin [m]."""
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
def ground_shape(ground: GroundTree, triangle: Placement, weights: wp.vec3) -> wp.vec3:
    """Height relative to the origin [m] and gradient at barycentric weights, as `smooth_height` has them."""
    a, b, c = ground.points[triangle.a], ground.points[triangle.b], ground.points[triangle.c]
    ab, bc, ca = wp.vec2(b.x - a.x, b.y - a.y), wp.vec2(c.x - b.x, c.y - b.y), wp.vec2(a.x - c.x, a.y - c.y)
    # Bezier coefficients relative to the first corner's height, so that nothing is lost on a mountain.
    height_b, height_c = b.z - a.z, c.z - a.z
    third = 1.0 / 3.0
    aab = third * (a.slope_x * ab[0] + a.slope_y * ab[1])
    aac = -third * (a.slope_x * ca[0] + a.slope_y * ca[1])
    bba = height_b - third * (b.slope_x * ab[0] + b.slope_y * ab[1])
    bbc = height_b + third * (b.slope_x * bc[0] + b.slope_y * bc[1])
    cca = height_c + third * (c.slope_x * ca[0] + c.slope_y * ca[1])
    ccb = height_c - third * (c.slope_x * bc[0] + c.slope_y * bc[1])
    abc = 0.25 * (aab + aac + bba + bbc + cca + ccb) - (height_b + height_c) / 6.0
    abc += triangle.bulge

    u, v, w = weights[0], weights[1], weights[2]
    rise = v * v * v * height_b + w * w * w * height_c + 6.0 * u * v * w * abc
    rise += 3.0 * (u * u * (v * aab + w * aac) + v * v * (u * bba + w * bbc) + w * w * (u * cca + v * ccb))
    slope_x = u * a.slope_x + v * b.slope_x + w * c.slope_x
    slope_y = u * a.slope_y + v * b.slope_y + w * c.slope_y
    return wp.vec3(a.z + rise, slope_x, slope_y)


@wp.func
def ground_below(ground: GroundTree, point: wp.vec3d) -> wp.vec3:
    """Height relative to `ground.origin` [m] and gradient (dz/dx, dz/dy) of the ground below or above a point."""
    x = point[0] - ground.origin[0]
    y = point[1] - ground.origin[1]
    # Beyond the map's edge it goes on level, at the height of the edge. What is not finite ends on the edge as well.
    held_x = wp.clamp(x, wp.float64(ground.low[0]), wp.float64(ground.high[0]))
    held_y = wp.clamp(y, wp.float64(ground.low[1]), wp.float64(ground.high[1]))
    leaf = ground_leaf(ground, wp.float32(held_x), wp.float32(held_y))

    place = leaf + 1
    end = place + ground.lists[leaf]
    nearest = float(_OUTSIDE)
    triangle = ground.lists[place]
    weights = wp.vec3(1.0, 0.0, 0.0)
    while place < end:
        candidate = ground.lists[place]
        found = ground_weights(ground.placements[candidate], held_x, held_y)
        least = wp.min(found[0], wp.min(found[1], found[2]))
        if least > nearest:
            nearest = least
            triangle = candidate
            weights = found
        place += 1
        if least >= _INSIDE:
            place = end

    if nearest < _INSIDE:
        weights = wp.vec3(wp.max(weights[0], 0.0), wp.max(weights[1], 0.0), wp.max(weights[2], 0.0))
        weights = weights / (weights[0] + weights[1] + weights[2])
    shape = ground_shape(ground, ground.placements[triangle], weights)
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
        roots, nodes, lists: The tree.
        placements: Of triangles, structured as `Placement`, shape [triangles].
        points: Structured as `GroundPoint`, shape [points].
        given: Number of each triangle in the order of the meshes, shape [triangles].
    """

    origin: np.ndarray
    low: np.ndarray
    high: np.ndarray
    cell: float
    columns: int
    rows: int
    roots: np.ndarray
    nodes: np.ndarray
    lists: np.ndarray
    placements: np.ndarray
    points: np.ndarray
    given: np.ndarray

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
        roots, nodes, counts, members = _tree(triangles, cell, columns, rows)
        # Triangles, and then points, in the order in which leaves first name them. Every triangle is in some leaf.
        given, members = _by_first_use(members)
        used, corners = _by_first_use(corners[given].ravel())
        corners = corners.reshape(-1, 3)
        structured = np.zeros(len(used), dtype=GroundPoint.numpy_dtype())
        heights = points[:, 2] - origin[2]
        values = (places[:, 0], places[:, 1], heights, gradients[:, 0], gradients[:, 1])
        for name, value in zip(("x", "y", "z", "slope_x", "slope_y"), values, strict=True):
            structured[name] = value[used]
        placements = _placements(places[used], corners, bulges[given])
        lists = np.empty(len(counts) + len(members), dtype=np.int32)
        heads = np.cumsum(counts + 1) - counts - 1
        lists[heads] = counts
        lists[np.delete(np.arange(len(lists)), heads)] = members
        roots, nodes = (
            np.where(part < 0, -1 - heads[np.maximum(-1 - part, 0)], part).astype(np.int32) for part in (roots, nodes)
        )
        tree = (roots, nodes, lists, placements, structured, given)
        return cls(origin, low, high, cell, columns, rows, *tree)

    def data(self, device: wp.DeviceLike = None) -> GroundTree:
        """The quadtree on a device."""

        def copied(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        ground = GroundTree()
        ground.roots, ground.nodes = copied(self.roots, wp.int32), copied(self.nodes, wp.int32)
        ground.lists = copied(self.lists, wp.int32)
        ground.placements = copied(self.placements, Placement)
        ground.points = copied(self.points, GroundPoint)
        ground.origin = wp.vec3d(*self.origin.tolist())
        ground.low, ground.high = wp.vec2(*self.low.tolist()), wp.vec2(*self.high.tolist())
        ground.cell = self.cell
        ground.columns, ground.rows = self.columns, self.rows
        return ground


def _by_first_use(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(numbers in the order of their first use, the same sequence in terms of places in that order)."""
    known, first, place = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return known[order], np.argsort(order)[place]


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
    placements["a"], placements["b"], placements["c"] = corners.T
    return placements


def _tree(
    triangles: np.ndarray, cell: float, columns: int, rows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(roots, nodes, counts, members) of triangles given relative to the table's corner, shape [triangles, 3, 2].

    A node < 0 is leaf number -1 - node; `counts` says how many of `members` belong to each leaf.

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
    return _joined(levels, leaves, middles, triangles, cell)


def _joined(
    levels: list[np.ndarray],
    leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    middles: list[np.ndarray],
    triangles: np.ndarray,
    cell: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Levels of squares as one array of nodes, and their leaves as lists, along the map."""
    tree = KDTree(triangles.mean(axis=1))
    leaf_counts = [len(squares) for squares, _, _ in leaves]
    first_leaf = np.cumsum([0, *leaf_counts])
    first_node = np.cumsum([0, *(len(level) for level in levels[1:])])  # the table's squares are no nodes
    number = np.empty(first_leaf[-1], dtype=np.int64)
    number[np.argsort(_along_the_map(np.concatenate(middles), cell), kind="stable")] = np.arange(len(number))

    owners: list[np.ndarray] = []
    members: list[np.ndarray] = []
    coded: list[np.ndarray] = []
    for depth, (level, (squares, of, which), middle) in enumerate(zip(levels, leaves, middles, strict=True)):
        numbers = number[first_leaf[depth] : first_leaf[depth + 1]]
        place = np.searchsorted(squares, of)
        empty = np.flatnonzero(np.bincount(place, minlength=len(squares)) == 0)
        nearest = np.asarray(tree.query(middle[empty])[1], dtype=np.int64)
        owners += [numbers[place], numbers[empty]]
        members += [which, nearest]
        codes = first_node[depth] + 4 * (level - 1)
        codes[squares] = -1 - numbers
        coded.append(codes)
    owner, member = np.concatenate(owners), np.concatenate(members)
    nodes = np.concatenate([*coded[1:], np.zeros(0, dtype=np.int64)])
    return coded[0], nodes, np.bincount(owner), member[np.argsort(owner, kind="stable")]


def _along_the_map(places: np.ndarray, cell: float) -> np.ndarray:
    """Keys that sort places by cells of the table and, within one, along Morton's curve."""
    steps = np.floor(places * (2**DEEPEST / cell)).astype(np.int64)
    x, y = steps[:, 0] % 2**DEEPEST, steps[:, 1] % 2**DEEPEST
    curve = np.zeros(len(places), dtype=np.int64)
    for bit in range(DEEPEST):
        curve |= ((x >> bit & 1) << (2 * bit)) | ((y >> bit & 1) << (2 * bit + 1))
    column, row = steps[:, 0] >> DEEPEST, steps[:, 1] >> DEEPEST
    return ((row * (column.max() + 1) + column) << (2 * DEEPEST)) + curve


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
