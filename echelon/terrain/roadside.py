"""What stands beside a road: houses, trees, light posts and hydrants, placed by a seed, clear of every road.

The road runs through quarters, some built up and some green: a slow random wave along it says which. Lamps and
hydrants stand in line at the edge of the verge; then houses are set back from the road, facing it; then trees fill the
gaps, many in a row along the road, some behind. Each kind draws from numbers of its own, so that thinning one leaves
where another might stand as it is. Whatever would touch a road, a side street or something that stands already is left
out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from echelon.terrain.course import Course

KINDS = ("house", "tree", "lamp", "hydrant")

SIZES: Mapping[str, tuple[float, float, float]] = {
    "house": (8.0, 10.0, 7.5),
    "tree": (4.4, 4.4, 7.5),
    "lamp": (0.3, 0.3, 7.0),
    "hydrant": (0.4, 0.4, 0.8),
}
"""Size of each kind at scale 1: along its x, which looks at the road, along its y, and upward [m].

A light post's is that of its foot: its arm reaches out over the road.
"""

COLORS: Mapping[str, int] = {"house": 6, "tree": 4, "lamp": 1, "hydrant": 2}
"""How many colours each kind comes in."""

ROOM = 0.5
"""Kept between whatever stands there and the verge or a side street [m]."""

_QUARTER = 350.0  # [m] from built-up to green, about
_BUILT_UP = 0.38  # of the wave 0..1: houses stand where it is more
_SET_BACK = (2.0, 8.0)  # [m], front gardens
_HOUSE_SCALES = (0.85, 1.25)
_TREE_SCALES = (0.7, 1.3)
_TREES_IN_ROW = 0.55  # of all trees


@dataclass(frozen=True)
class Placement:
    """Everything of one kind.

    Attributes:
        positions: Where each stands: the middle of its foot, on the ground [m], shape [n, 3]
        yaws: Which way its x looks, from east, counter-clockwise [rad],         shape [n]
        scales: Along its own axes,                                              shape [n, 3]
        colors: Which of the kind's `COLORS`,                                    int32 [n]
        s: How far along the road it stands [m],                                 shape [n]
    """

    positions: np.ndarray
    yaws: np.ndarray
    scales: np.ndarray
    colors: np.ndarray
    s: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)


Roadside = Mapping[str, Placement]
"""For each of `KINDS` what stands there, in order along the road."""


def place_roadside(course: Course) -> Roadside:
    """Houses, trees, light posts and hydrants of a course; the same for the same course."""
    site = _Site(course)
    scenery = course.scenery
    placed = {
        "lamp": site.place("lamp", *_in_line(site, scenery.lamp_spacing, both_sides=True)),
        "hydrant": site.place("hydrant", *_in_line(site, scenery.hydrant_spacing, both_sides=False)),
        "house": site.place("house", *_houses(site, scenery.house_spacing)),
        "tree": site.place("tree", *_trees(site, scenery.tree_spacing, scenery.depth)),
    }
    return {kind: placed[kind] for kind in KINDS}


# ---- where each kind would like to stand -----------------------------------------------------------------------------
# Each gives s [n], offsets [n], scales [n, 3] and a number 0..1 that decides the colour [n].
def _in_line(site: _Site, spacing: float, both_sides: bool) -> tuple[np.ndarray, ...]:
    """At the edge of the verge every so often: on alternate sides, or all on the right."""
    count = int(site.length / spacing) if spacing else 0
    s = (np.arange(count) + (0.5 if both_sides else 0.3)) * (site.length / max(count, 1))
    side = np.where(np.arange(count) % 2 == 0, 1.0, -1.0) if both_sides else -np.ones(count)
    return s, side * (site.edge + ROOM + 0.25), np.ones((count, 3)), site.uniform(1, 1, count)[0]


def _houses(site: _Site, spacing: float) -> tuple[np.ndarray, ...]:
    count = 2 * int(site.length / spacing) if spacing else 0
    jitter, back, width, height, color = site.uniform(2, 5, count)
    s = ((np.arange(count) // 2) + 0.25 + 0.5 * jitter) * (2.0 * site.length / max(count, 1))
    low, high = _HOUSE_SCALES
    scales = np.stack([low + (high - low) * width, low + (high - low) * back, 0.8 + 0.8 * height], axis=1)
    # Set back by what the corner of a house that does not stand square to the road needs.
    reach = 0.5 * np.hypot(*(scales[:, :2] * np.array(SIZES["house"][:2])).T)
    offset = site.edge + ROOM + _SET_BACK[0] + (_SET_BACK[1] - _SET_BACK[0]) * back**2 + reach
    chosen = site.built_up(s) > _BUILT_UP
    side = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    return s[chosen], (side * offset)[chosen], scales[chosen], color[chosen]


def _trees(site: _Site, spacing: float, depth: float) -> tuple[np.ndarray, ...]:
    count = 2 * int(site.length / spacing) if spacing else 0
    along, row, back, size, color = site.uniform(3, 5, count)
    s = (np.arange(count) + along) * (site.length / max(count, 1))
    low, high = _TREE_SCALES
    scale = low + (high - low) * size
    in_row = row < _TREES_IN_ROW
    nearest = site.edge + ROOM + 0.5 * SIZES["tree"][0] * scale
    offset = nearest + np.where(in_row, 1.0, 3.0 + (depth - 3.0) * back**1.5)
    # Where it is green a few more stand behind, where it is built up a few less.
    chosen = in_row | (site.built_up(s) < 0.25 + back)
    side = np.where(site.uniform(4, 1, count)[0] < 0.5, 1.0, -1.0)
    scales = np.stack([scale, scale, scale * (0.85 + 0.3 * color)], axis=1)
    return s[chosen], (side * offset)[chosen], scales[chosen], (7.0 * color[chosen]) % 1.0


class _Site:
    """The ground beside a road, and what stands on it so far."""

    def __init__(self, course: Course):
        self._course, self._line = course, course.centreline
        self.length = course.length
        self.edge = course.half_width + course.verge
        self._places = np.empty((0, 2))
        self._reaches = np.empty(0)
        knots = max(4, round(self.length / _QUARTER))
        self._quarters = self.uniform(0, 1, knots)[0]
        points = [
            points[0] + np.linspace(0.0, 1.0, max(2, int(np.hypot(*(points[1] - points[0])) / 0.5)))[:, None]
            * (points[1] - points[0])
            for street in course.side_streets
            for points in np.stack([np.array(street)[:-1], np.array(street)[1:]], axis=1)
        ]  # fmt: skip
        self._side_streets = KDTree(np.vstack(points)) if points else None

    def uniform(self, stream: int, rows: int, count: int) -> np.ndarray:
        """Numbers 0..1 from a counter: so many for each of so many objects, shape [rows, count]."""
        bits = np.random.Philox(key=self._course.seed + (stream << 64)).random_raw(rows * count)
        # One object's after the other's: those of the first do not depend on how many there are.
        return ((bits >> np.uint64(11)).astype(np.float64) * 2.0**-53).reshape(count, rows).T

    def built_up(self, s: np.ndarray) -> np.ndarray:
        """How built up the road is, 0..1, shape [...]."""
        place = s / self.length * len(self._quarters)
        index = np.floor(place).astype(np.int64)
        part = place - index
        part = part * part * (3.0 - 2.0 * part)
        before, after = (self._quarters[(index + step) % len(self._quarters)] for step in (0, 1))
        return before + part * (after - before)

    def place(self, kind: str, s: np.ndarray, offsets: np.ndarray, scales: np.ndarray, color: np.ndarray) -> Placement:
        """Stand those of a kind that have room where they would like to stand."""
        flat = self._line.position(s)[:, :2] + offsets[:, None] * self._line.left(s)
        sizes = scales[:, :2] * np.array(SIZES[kind][:2])
        reaches = 0.5 * (np.hypot(*sizes.T) if kind == "house" else sizes.max(axis=1, initial=0.0))
        nearest, offset = self._line.closest(flat)
        chosen = np.abs(offset) >= self.edge + ROOM + reaches - 0.25
        if self._side_streets is not None and len(flat):
            gap = self._side_streets.query(flat)[0]
            chosen &= gap >= 0.5 * self._course.side_street_width + ROOM + reaches
        chosen = np.array([index for index in np.flatnonzero(chosen) if self._claim(flat[index], reaches[index])], int)
        flat, scales, nearest = flat[chosen], scales[chosen], nearest[chosen]
        toward = self._line.position(nearest)[:, :2] - flat
        yaws = np.arctan2(toward[:, 1], toward[:, 0])
        if kind == "tree":
            yaws = 2.0 * np.pi * color[chosen]
        colors = np.minimum((color[chosen] * COLORS[kind]).astype(np.int32), COLORS[kind] - 1)
        positions = np.column_stack([flat, self._standing(kind, flat, yaws, scales)])
        return Placement(positions, yaws, scales, colors, nearest)

    def _claim(self, place: np.ndarray, reach: float) -> bool:
        """Whether there is room for a disc among those that stand already; if so, it is taken."""
        gaps = np.hypot(*(self._places - place).T)
        if (gaps < self._reaches + reach).any():
            return False
        self._places = np.vstack([self._places, place])
        self._reaches = np.append(self._reaches, reach)
        return True

    def _standing(self, kind: str, flat: np.ndarray, yaws: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """Heights at which they stand: a house on the lowest ground beneath its corners, so that no corner floats."""
        height = self._course.surfaces.height
        if kind != "house" or not len(flat):
            return height(flat)
        x, y = (0.5 * size * scales[:, axis] for axis, size in enumerate(SIZES[kind][:2]))
        cos, sin = np.cos(yaws), np.sin(yaws)
        corners = [flat + np.stack([a * cos - b * sin, a * sin + b * cos], axis=1) for a in (x, -x) for b in (y, -y)]
        return np.min([height(corner) for corner in corners], axis=0)
