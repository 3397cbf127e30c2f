"""Normals of a mesh that has none: smooth over gentle edges, sharp over others."""

from __future__ import annotations

import numpy as np

SHARP = np.radians(50.0)
"""Neighbouring triangles that meet at more than this are drawn with an edge [rad]."""


def smoothed(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Give a mesh of triangles its normals.

    Each corner's normal is the mean of those of the triangles around its point that lie within `SHARP` of its own,
    weighted by their angles there, so that how a surface is cut into triangles does not show. A point whose corners
    differ is doubled.

    Args:
        points: [m], shape [n, 3]; those of no triangle are left out.
        triangles: Counter-clockwise seen from outside, shape [m, 3].

    Returns:
        Points [p, 3], unit normals [p, 3], corners of each face (all 3) [m], and the faces' points [3 m].
    """
    corners = points[triangles]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(face_normals, axis=1, keepdims=True)
    face_normals = face_normals / np.maximum(lengths, 1e-300)
    weights = _angles(corners) * (lengths > 0.0)
    # Corners of the same point lie together, each run of them is one point's.
    flat = triangles.reshape(-1)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(len(points) + 1))
    owner, weight = order // 3, weights.reshape(-1)[order]
    new_points: list[np.ndarray] = []
    new_normals: list[np.ndarray] = []
    indices = np.empty(len(flat), dtype=np.int64)
    for point in np.flatnonzero(np.diff(starts)):
        run = slice(starts[point], starts[point + 1])
        around = face_normals[owner[run]]
        near = around @ around.T > np.cos(SHARP)
        sums = (near * weight[run]) @ around
        sizes = np.linalg.norm(sums, axis=1, keepdims=True)
        normals = np.where(sizes > 1e-12, sums / np.maximum(sizes, 1e-12), around)
        different, which = np.unique(np.round(normals, 6), axis=0, return_inverse=True)
        indices[order[run]] = len(new_points) + which.reshape(-1)
        for normal in different:
            new_points.append(points[point])
            new_normals.append(normal / max(float(np.linalg.norm(normal)), 1e-12))
    return np.array(new_points), np.array(new_normals), np.full(len(triangles), 3), indices


def _angles(corners: np.ndarray) -> np.ndarray:
    """Angles of triangles at their corners [rad], shape [m, 3]."""
    result = np.empty(corners.shape[:2])
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        result[:, k] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
    return result
