"""The ground as it is drawn, asked for heights: shadows, paint and scenery must lie on the triangles that are seen.

Triangles are found in a grid of square cells over the map. Where one stretch of ground lies above another, the one
that is nearest to the height asked about counts.
"""

from __future__ import annotations

import numpy as np

CELL = 6.0  # [m]
_CHUNK = 4096  # places looked up at a time: bounds the memory


class DisplayedGround:
    """Triangles of ground, indexed."""

    def __init__(self, corners: np.ndarray) -> None:
        """
        Args:
            corners: Of the triangles [m], float64, shape [triangles, 3, 3]; upright ones are left out.
        """
        edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normals = np.cross(edge1, edge2)
        lengths = np.linalg.norm(normals, axis=1)
        kept = np.abs(normals[:, 2]) > 1e-6 * np.maximum(lengths, 1e-12)
        self._corners = np.asarray(corners[kept], dtype=np.float64)
        normals = normals[kept] / lengths[kept, None]
        self._normals = normals * np.sign(normals[:, 2:])
        plan = self._corners[..., :2]
        self._low = plan.reshape(-1, 2).min(axis=0) if len(plan) else np.zeros(2)
        first = np.floor((plan.min(axis=1) - self._low) / CELL).astype(np.int64)
        last = np.floor((plan.max(axis=1) - self._low) / CELL).astype(np.int64)
        self._shape = last.max(axis=0) + 1 if len(plan) else np.ones(2, np.int64)
        spans = last - first + 1
        counts = spans.prod(axis=1)
        owner = np.repeat(np.arange(len(counts)), counts)
        step = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        column = first[owner, 0] + step % spans[owner, 0]
        row = first[owner, 1] + step // spans[owner, 0]
        cell = row * self._shape[0] + column
        order = np.argsort(cell, kind="stable")
        self._members = owner[order]
        self._starts = np.searchsorted(cell[order], np.arange(self._shape.prod() + 1))

    def heights(self, places: np.ndarray) -> np.ndarray:
        """Heights of the ground at places on the map, whose third number says about where to look [m].

        Args:
            places: [m], shape [n, 3].

        Returns:
            [m], shape [n]; what was given where there is no ground.
        """
        planes = self.planes(places)
        return (planes[:, 3] - (planes[:, :2] * places[:, :2]).sum(axis=1)) / planes[:, 2]

    def planes(self, places: np.ndarray) -> np.ndarray:
        """The planes (n_x, n_y, n_z, d), n . x = d, of the triangles beneath or above places [m], shape [n, 4].

        Level ground at the height of the place where there is none.
        """
        places = np.asarray(places, dtype=np.float64)
        found = np.zeros((len(places), 4))
        for start in range(0, len(places), _CHUNK):
            part = slice(start, start + _CHUNK)
            triangle = self._find(places[part])
            hit = triangle >= 0
            normals = self._normals[triangle[hit]]
            found[part][hit, :3] = normals
            found[part][hit, 3] = (normals * self._corners[triangle[hit], 0]).sum(axis=1)
            found[part][~hit, 2] = 1.0
            found[part][~hit, 3] = places[part][~hit, 2]
        return found

    def _find(self, places: np.ndarray) -> np.ndarray:
        """The triangle of each place, -1 where there is none, shape [n]."""
        cell = np.floor((places[:, :2] - self._low) / CELL).astype(np.int64)
        inside = ((cell >= 0) & (cell < self._shape)).all(axis=1)
        number = np.where(inside, cell[:, 1] * self._shape[0] + cell[:, 0], 0)
        begin = self._starts[number]
        count = np.where(inside, self._starts[number + 1] - begin, 0)
        owner = np.repeat(np.arange(len(places)), count)
        step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        triangle = self._members[begin[owner] + step]
        a, b, c = (self._corners[triangle, corner] for corner in range(3))
        p = places[owner]
        around = [_side(b, c, p), _side(c, a, p), _side(a, b, p)]
        area = around[0] + around[1] + around[2]
        within = np.min([part * np.sign(area) for part in around], axis=0) >= -1e-9 * np.abs(area) - 1e-12
        normal = self._normals[triangle]
        height = (normal * (a - p)).sum(axis=1) / normal[:, 2]
        best = np.full(len(places), -1, dtype=np.int64)
        # By distance in height, nearest last, so that it is what stays.
        order = np.flatnonzero(within)
        order = order[np.argsort(-np.abs(height[order]), kind="stable")]
        best[owner[order]] = triangle[order]
        return best


def _side(start: np.ndarray, end: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Twice the area, on the map, of the triangles from lines to places; positive to the left."""
    return (end[:, 0] - start[:, 0]) * (place[:, 1] - start[:, 1]) - (end[:, 1] - start[:, 1]) * (
        place[:, 0] - start[:, 0]
    )
