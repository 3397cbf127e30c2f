"""Where a crowd starts: a hexagonal pattern, a little jitter, and the check that no two overlap."""

from __future__ import annotations

import math

import numpy as np


def hexagonal_places(count: int) -> np.ndarray:
    """The ``count`` points of a hexagonal lattice of spacing one that lie nearest to the origin, shape [count, 2].

    They come nearest first, equally near ones by angle, so that a longer list begins with a shorter one.
    """
    reach = 3 + int(0.61 * math.sqrt(count))  # a disc of that many cells has a radius of 0.525 sqrt(count)
    i, j = (axis.ravel() for axis in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    norm = i * i + i * j + j * j  # exact: the squared distance of i a + j b with |a| = |b| = 1 and 60 degrees between
    points = np.stack([i + 0.5 * j, math.sqrt(0.75) * j], axis=1)
    order = np.lexsort((np.round(np.arctan2(points[:, 1], points[:, 0]), 6), norm))
    return points[order[:count]]


def jitter(count: int, seed: int) -> np.ndarray:
    """Two numbers from -1 to 1 for each agent, from a counter: agent i's do not depend on the count."""
    bits = np.random.Philox(key=seed).random_raw(2 * count)
    return ((bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0).reshape(count, 2)


def overlapping_pair(positions: np.ndarray, least: float) -> tuple[int, int, float] | None:
    """Two positions nearer to one another than ``least`` [m], shape [count, 2]: indices a < b and distance, or None.

    A grid whose cells are so small that two in one cell overlap for certain; then, with at most one in each, every cell
    is compared with those within two of it.
    """
    cells = np.floor(positions / (0.707 * least)).astype(np.int64)
    cells -= cells.min(axis=0) - 2
    rows = int(cells[:, 1].max()) + 3
    keys = cells[:, 0] * rows + cells[:, 1]
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    found: list[tuple[int, int, float]] = []
    for dx, dy in [(0, 0), *((dx, dy) for dx in range(3) for dy in range(-2, 3) if (dx, dy) > (0, 0))]:
        slot = np.searchsorted(ordered, keys + dx * rows + dy)
        if (dx, dy) == (0, 0):  # the next in the same cell, if there is one
            slot[order] = np.arange(1, len(keys) + 1)
        inside = slot < len(keys)
        slot = np.minimum(slot, len(keys) - 1)
        near = np.flatnonzero(inside & (ordered[slot] == keys + dx * rows + dy))
        other = order[slot[near]]
        distance = np.hypot(*(positions[near] - positions[other]).T)
        for i in np.flatnonzero(distance < least).tolist():
            a, b = sorted((int(near[i]), int(other[i])))
            found.append((a, b, float(distance[i])))
    return min(found, default=None)
