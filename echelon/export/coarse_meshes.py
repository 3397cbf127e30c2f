"""Round shapes with fewer faces, for what is only a few pixels wide, and for shadows."""

from __future__ import annotations

import numpy as np

from echelon.export.mesh_parts import separate_parts
from echelon.export.shapes import Mesh

LEVELS = 3  # along each axis of a piece's box: a ball becomes 26 points
FEWEST = 60  # points of a piece that is made coarser


def coarsened(mesh: Mesh) -> Mesh:
    """The mesh with points of its round pieces gathered where they are near one another.

    Pieces that are not convex, such as tyres, and those of few points stay as they are.
    """
    piece = separate_parts(mesh)
    gather = np.arange(len(mesh.points))
    for number in range(int(piece.max(initial=-1)) + 1):
        members = np.flatnonzero(piece == number)
        if len(members) >= FEWEST and _is_convex(mesh, members):
            gather[members] = members[_representatives(mesh.points[members].astype(np.float64))]
    triangles = gather[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, corners = np.unique(triangles, return_inverse=True)
    return Mesh(
        points=mesh.points[used],
        normals=mesh.normals[used],
        face_vertex_counts=np.full(len(triangles), 3, dtype=np.int32),
        face_vertex_indices=corners.reshape(-1).astype(np.int32),
    )


def _representatives(points: np.ndarray) -> np.ndarray:
    """For each point the one of its neighbourhood that is farthest out, shape [n]."""
    low, high = points.min(axis=0), points.max(axis=0)
    place = (points - low) / np.maximum(high - low, 1e-9)
    level = np.rint(place * (LEVELS - 1)).astype(np.int64)
    cell = (level[:, 0] * LEVELS + level[:, 1]) * LEVELS + level[:, 2]
    out = np.linalg.norm(place - 0.5, axis=1)
    order = np.lexsort((-out, cell))
    _, first, inverse = np.unique(cell[order], return_index=True, return_inverse=True)
    found = np.empty(len(points), dtype=np.int64)
    found[order] = order[first][inverse.reshape(-1)]
    return found


def _is_convex(mesh: Mesh, members: np.ndarray) -> bool:
    """Whether no point of a piece lies outside of one of its faces."""
    a, b, c = (mesh.points[mesh.triangles[np.isin(mesh.triangles[:, 0], members)][:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a).astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.maximum(lengths, 1e-12)
    points = mesh.points[members].astype(np.float64)
    outside = points @ normals.T - np.sum(normals * a, axis=1)
    return bool(outside.max() <= 1e-3 * np.ptp(points, axis=0).max())
