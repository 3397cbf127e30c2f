"""Which pieces a mesh falls into."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from echelon.export.shapes import Mesh


def separate_parts(mesh: Mesh) -> np.ndarray:
    """Which connected part each point of a mesh belongs to, numbered in the order of first points, shape [n].

    Points at the same place are one: sharp edges have their points twice.
    """
    _, place = np.unique(mesh.points, axis=0, return_inverse=True)
    place = place.reshape(-1)
    corners = place[mesh.triangles]
    starts, ends = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    count = int(place.max(initial=-1)) + 1
    edges = coo_array((np.ones(len(starts)), (starts, ends)), shape=(count, count))
    label = connected_components(edges, directed=False)[1][place]
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]
