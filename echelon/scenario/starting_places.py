"""Where a crowd starts: a pattern, a little jitter, and the check that no two overlap."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

Pattern = Literal["hexagonal", "line", "rows", "circle"]


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


def line_places(count: int) -> np.ndarray:
    """``count`` points along y, one apart, from the middle outwards to both sides in turn, shape [count, 2]."""
    steps = np.arange(count)
    return np.column_stack([np.zeros(count), (steps + 1) // 2 * np.where(steps % 2, 1.0, -1.0) + 0.0])


def row_places(count: int, rows: int) -> np.ndarray:
    """``count`` points in rows along y, one apart, the first in front (x), the last maybe shorter, shape [count, 2].

    Args:
        count: How many.
        rows: At most; 0 for about as many as there are points in a row.
    """
    rows = min(rows or max(round(math.sqrt(count)), 1), count)
    columns = -(-count // rows)
    row, column = np.divmod(np.arange(count), columns)
    widths = np.minimum(count - row * columns, columns)
    return np.column_stack([0.5 * (-(-count // columns) - 1) - row, column - 0.5 * (widths - 1)])


def circle_places(count: int) -> np.ndarray:
    """``count`` points of a circle about the origin, neighbours one apart, shape [count, 2]."""
    if count == 1:
        return np.zeros((1, 2))
    angles = 2.0 * math.pi * np.arange(count) / count
    return 0.5 / math.sin(math.pi / count) * np.column_stack([np.cos(angles), np.sin(angles)])


PATTERNS: Mapping[Pattern, Callable[[int, int], np.ndarray]] = {
    "hexagonal": lambda count, rows: hexagonal_places(count),
    "line": lambda count, rows: line_places(count),
    "rows": row_places,
    "circle": lambda count, rows: circle_places(count),
}
"""Places of ``count`` agents, neighbours one apart, in so many rows (which only "rows" goes by), shape [count, 2]."""


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
