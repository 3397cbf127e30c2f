r"""Triangles that are small only where a surface is rough: for land, most of which is smooth.

`triangulate` cuts a surface along whole lines, which suits a road. Land that is rough in one place would be cut along
every line through that place; here each cell is cut into four by itself until what it says about the height is within
the tolerance. Neighbours differ by no more than a factor of two in size, and the triangles of a cell fan out from its
middle to its corners, and to the middle of each edge beyond which cells are smaller:

        +-------+---+       So every edge belongs to two triangles that agree about it: there are no cracks.
        | \   / |   |
        |   +---+---+
        | /   \ |   |
        +-------+---+
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from echelon.terrain.nurbs import NurbsSurface
from echelon.terrain.triangulation import SAFETY, TriangleMesh, with_bulges

SMALLEST = 2  # lattice steps of a cell, so that its middle is on the lattice
LARGEST = 64  # lattice steps of the cells to begin with

_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # counter-clockwise


@dataclass(frozen=True)
class _Lattice:
    """Whole numbers for places on a surface: `LARGEST` steps from line to line."""

    surface: NurbsSurface
    u: np.ndarray
    v: np.ndarray

    def parameters(self, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        numbers = np.arange(len(self.u)), np.arange(len(self.v))
        return np.interp(i / LARGEST, numbers[0], self.u), np.interp(j / LARGEST, numbers[1], self.v)

    def key(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return i * (LARGEST * len(self.v)) + j

    def place(self, key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return key // (LARGEST * len(self.v)), key % (LARGEST * len(self.v))


def triangulate_adaptively(
    surface: NurbsSurface, tolerance: float, u: np.ndarray, v: np.ndarray, name: str = "surface"
) -> TriangleMesh:
    """Cut a surface into smooth triangles of different sizes.

    Args:
        surface: A height field with u x v upwards.
        tolerance: Greatest error of the smooth height [m].
        u, v: Lines between the largest cells, ascending, over the whole surface.
        name: Of the mesh.

    Raises:
        ValueError: The tolerance is not positive.
    """
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}; it must be greater than 0")
    lattice = _Lattice(surface, np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
    i, j = np.meshgrid(LARGEST * np.arange(len(u) - 1), LARGEST * np.arange(len(v) - 1), indexing="ij")
    cells = np.stack([i.ravel(), j.ravel(), np.full(i.size, LARGEST)], axis=1)
    done: list[np.ndarray] = []
    while len(cells):
        split = (_errors(lattice, cells) > SAFETY * tolerance) & (cells[:, 2] > SMALLEST)
        done.append(cells[~split])
        cells = _quartered(cells[split])
    return _fans(lattice, _balanced(lattice, np.concatenate(done)), name)


def _quartered(cells: np.ndarray) -> np.ndarray:
    half = cells[:, 2] // 2
    corners = cells[:, None, :2] + half[:, None, None] * _CORNERS
    return np.concatenate([corners, np.broadcast_to(half[:, None, None], (len(cells), 4, 1))], axis=2).reshape(-1, 3)


def _errors(lattice: _Lattice, cells: np.ndarray) -> np.ndarray:
    """How far the edges of the fans are off the surface, shape [cells] [m]."""
    size = cells[:, 2]
    parts = size[:, None] * np.array([0.0, 1.0, 0.5])
    u, v = lattice.parameters(cells[:, :1] + parts, cells[:, 1:2] + parts)
    u, v = u[:, [0, 1, 1, 0, 2]], v[:, [0, 0, 1, 1, 2]]  # four corners and the middle
    points, along_u, along_v = lattice.surface.derivatives(u, v)
    normals = np.cross(along_u, along_v)
    gradients = -normals[..., :2] / normals[..., 2:]
    start = np.array([0, 1, 2, 3, 0, 1, 2, 3])
    end = np.array([1, 2, 3, 0, 4, 4, 4, 4])
    middles = lattice.surface.point(0.5 * (u[:, start] + u[:, end]), 0.5 * (v[:, start] + v[:, end]))
    a, b, slope_a, slope_b = points[:, start], points[:, end], gradients[:, start], gradients[:, end]
    heights = 0.5 * (a + b)[..., 2] + 0.125 * np.sum((slope_a - slope_b) * (b - a)[..., :2], axis=-1)
    heights += np.sum(0.5 * (slope_a + slope_b) * (middles - 0.5 * (a + b))[..., :2], axis=-1)
    return np.abs(heights - middles[..., 2]).max(axis=1)


def _balanced(lattice: _Lattice, cells: np.ndarray) -> np.ndarray:
    """Cells of which no two neighbours differ by more than a factor of two in size."""
    while True:
        corners = np.unique(_corner_keys(lattice, cells))
        size = cells[:, 2:]
        quarters = np.array([[1, 0], [3, 0], [4, 1], [4, 3], [3, 4], [1, 4], [0, 3], [0, 1]])
        places = cells[:, None, :2] + (size[:, None] * quarters) // 4
        small = _among(lattice.key(places[..., 0], places[..., 1]), corners).any(axis=1) & (size[:, 0] > SMALLEST)
        if not small.any():
            return cells
        cells = np.concatenate([cells[~small], _quartered(cells[small])])


def _corner_keys(lattice: _Lattice, cells: np.ndarray) -> np.ndarray:
    places = cells[:, None, :2] + cells[:, 2][:, None, None] * _CORNERS
    return lattice.key(places[..., 0], places[..., 1])


def _among(keys: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Which keys are known; `known` is sorted."""
    place = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    return known[place] == keys


def _fans(lattice: _Lattice, cells: np.ndarray, name: str) -> TriangleMesh:
    """The triangles of balanced cells."""
    corners = _corner_keys(lattice, cells)
    half = cells[:, 2] // 2
    middles = lattice.key(cells[:, 0] + half, cells[:, 1] + half)
    following = np.roll(corners, -1, axis=1)
    between = (corners + following) // 2  # keys are linear in the place
    hangs = _among(between, np.unique(corners))
    center = np.broadcast_to(middles[:, None], corners.shape)
    whole = np.stack([center, corners, following], axis=-1)[~hangs]
    first, second = (
        np.stack(ends, axis=-1)[hangs] for ends in ((center, corners, between), (center, between, following))
    )
    keys, triangles = np.unique(np.concatenate([whole, first, second]), return_inverse=True)
    u, v = lattice.parameters(*lattice.place(keys))
    points, along_u, along_v = lattice.surface.derivatives(u, v)
    normals = np.cross(along_u, along_v)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = TriangleMesh(name, points, normals, np.stack([u, v], axis=1), triangles.reshape(-1, 3).astype(np.int32))
    return with_bulges(mesh, lattice.surface)
