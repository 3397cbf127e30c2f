"""The strip of ground that belongs to a road: how wide it is where, how high, and how it blends into the land.

Across it, from the centreline outwards:

        0 ............ half width ....... level ................ limit
        | asphalt      |  verge           |  shoulder            |  land
        | share 1                         |  share falls to 0    |

The *share* is how much of the height is the road's and how much the land's, smooth up to its second derivative, so road
and land meet without a step and without an edge. Two things make a strip narrower than it is meant to be:

* Inside a bend of radius R nothing lies farther out than R, where the sections of the road would cross each other: the
  limit is `FOLD` times R, taken gently on both sides of the bend.
* Where another stretch passes close by, or crosses, a place belongs to both. The *feet* of a place are all points of
  the centreline within whose strip it lies. Its height blends theirs by nearness, so there is one height everywhere,
  however often and at whatever angle a road meets itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d
from scipy.spatial import KDTree

from echelon.terrain.spline import Centreline

FOLD = 0.8  # of the radius of a bend that a strip may take up on its inner side
LEVEL_PART = 0.8  # of a limit so narrowed that is still level
BEND_EASE = 4.0  # [m], over which a limit narrows before and after a bend
NARROWEST = 0.2  # [m]

RUN_OUT = 30.0  # [m], that an open road goes on straight beyond its ends
RUN_OUT_BLEND = 12.0  # [m], over which it then sinks into the land

FULL_BANK_RADIUS = 25.0  # [m]: bends as tight as this have all the banking there is
BANK_EASE = 8.0  # [m], standard deviation of the smoothing that rolls banking in and out

SECTION_SPACING = 2.0  # [m] between sections of the surface, at most
CLOSE_SPACING = 0.5  # [m], where stretches meet
CLOSEST_SPACING = 0.4  # [m], in the tightest bends
BEND_PART = 0.12  # of the radius of a bend between its sections

ROUNDABOUT = 1.05  # times the straight way, from which the way along the road may lead to another stretch

_TABLE_STEP = 1.0  # [m]
_NEARNESS = 1.0  # [m]: stretches nearer than this count for no more


@dataclass(frozen=True)
class Feet:
    """Where places lie along a road; a place in the strips of several stretches has a foot on each.

    Attributes:
        place: Index of the place,                      shape [feet]
        s: Arc length of the foot [m],                  shape [feet]
        offset: From it to the place, left positive [m], shape [feet]
    """

    place: np.ndarray
    s: np.ndarray
    offset: np.ndarray


class RoadStrip:
    """The strip of a road, by arc length and offset.

    Attributes:
        centreline: In its middle.
        half_width: From the centreline to the edge of the asphalt [m].
        level: From the centreline to where the share begins to fall, where there is room [m].
        limit: From the centreline to the land, where there is room [m].
        start, end: Arc lengths between which there is road [m].
    """

    def __init__(self, centreline: Centreline, half_width: float, verge: float, shoulder: float, bank: float):
        """Find out how wide the strip can be.

        Args:
            centreline: Of the road.
            half_width: Of the asphalt [m].
            verge: Ground beside it that is level with it [m].
            shoulder: Beyond that, over which road becomes land [m].
            bank: Greatest slope across the road in bends, the inner side lower (0.05: 5 cm a metre).
        """
        self.centreline = centreline
        self.half_width = half_width
        self.level = half_width + verge
        self.limit = self.level + shoulder
        beyond = 0.0 if centreline.closed else RUN_OUT
        self.start, self.end = -beyond, centreline.length + beyond
        count = max(8, int(np.ceil((self.end - self.start) / _TABLE_STEP)))
        self._table_s = np.linspace(self.start, self.end, count + 1)
        self._step = (self.end - self.start) / count
        bends = centreline.curvature(self._table_s)
        self._limits = np.stack([self._limit_inside(side * bends) for side in (1.0, -1.0)])
        self._banks = self._smoothed_bank(bends, bank)
        self._bends = np.abs(bends)
        self._positions = centreline.position(self._table_s)
        along = centreline.tangent(self._table_s)[:, :2]
        self._along = along / np.linalg.norm(along, axis=1, keepdims=True)
        # A place is nearer than this to the sample before its foot.
        self._reach = float(np.hypot(self.limit, self._step)) + 0.01
        self._tree = KDTree(self._positions[:-1, :2])
        self._meeting = self._meeting_samples()

    @property
    def _mode(self) -> str:
        return "wrap" if self.centreline.closed else "nearest"

    def _limit_inside(self, bends: np.ndarray) -> np.ndarray:
        """Limit on the side towards which positive curvature bends [m]."""
        radius = 1.0 / np.maximum(bends, 1.0e-6)
        narrow = np.maximum(np.minimum(self.limit, FOLD * radius), NARROWEST)
        if self.centreline.closed:
            narrow = narrow[:-1]
        size = 2 * max(1, round(BEND_EASE / self._step)) + 1
        eased = minimum_filter1d(narrow, 2 * size + 1, mode=self._mode)
        for _ in range(2):  # each stays within what the minimum took in
            eased = uniform_filter1d(eased, size, mode=self._mode)
        return np.append(eased, eased[0]) if self.centreline.closed else eased

    def _smoothed_bank(self, bends: np.ndarray, bank: float) -> np.ndarray:
        slopes = bank * np.clip(FULL_BANK_RADIUS * bends, -1.0, 1.0)
        if self.centreline.closed:
            eased = gaussian_filter1d(slopes[:-1], BANK_EASE / self._step, mode="wrap")
            return np.append(eased, eased[0])
        return gaussian_filter1d(slopes, BANK_EASE / self._step, mode="nearest")

    def _meeting_samples(self) -> np.ndarray:
        """Which samples of the table have another stretch so near that their strips may overlap."""
        flat = self._positions[:-1, :2]
        pairs = self._tree.query_pairs(2.0 * self.limit + 2.0 * self._step, output_type="ndarray")
        first, second = pairs.T
        apart = np.abs(self.centreline.difference(self._table_s[first], self._table_s[second]))
        other = apart > ROUNDABOUT * np.linalg.norm(flat[first] - flat[second], axis=1) + _TABLE_STEP
        meeting = np.zeros(len(self._table_s), dtype=bool)
        meeting[first[other]] = True
        meeting[second[other]] = True
        meeting[-1] = meeting[0] if self.centreline.closed else meeting[-2]
        return meeting

    # ---- by arc length and offset ------------------------------------------------------------------------------------
    def _at(self, s: np.ndarray, values: np.ndarray) -> np.ndarray:
        if self.centreline.closed:
            s = np.mod(s, self.centreline.length)
        return np.interp(s, self._table_s, values)

    def limits(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the strip ends to the left and to the right, both positive [m], shape [...]."""
        return self._at(s, self._limits[0]), self._at(s, self._limits[1])

    def levels(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Up to where it is all road, to the left and to the right, both positive [m], shape [...]."""
        left, right = self.limits(s)
        return np.minimum(self.level, LEVEL_PART * left), np.minimum(self.level, LEVEL_PART * right)

    def bank(self, s: np.ndarray) -> np.ndarray:
        """Slope across, positive where the left side is lower, shape [...]."""
        return self._at(s, self._banks)

    def meets(self, s: np.ndarray) -> np.ndarray:
        """Whether another stretch may come so near that strips overlap, shape [...]."""
        return self._at(s, self._meeting.astype(np.float64)) > 0.0

    @property
    def meets_itself(self) -> bool:
        """Whether strips may overlap anywhere."""
        return bool(self._meeting.any())

    def height(self, s: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Of the road itself [m], shape [...]."""
        return self.centreline.position(s)[..., 2] - self.bank(s) * offset

    def share(self, s: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """How much of the height is the road's, 1 on it and 0 from the limit on, shape [...]."""
        out = np.abs(offset)
        level, limit = (np.where(offset > 0.0, *sides) for sides in (self.levels(s), self.limits(s)))
        share = _smooth_fall((out - level) / (limit - level))
        if self.centreline.closed:
            return share
        return share * _smooth_fall(1.0 - np.minimum(s - self.start, self.end - s) / RUN_OUT_BLEND)

    def sections(self) -> np.ndarray:
        """Arc lengths to cut the surface at, from the start to the end: closer in bends and where stretches meet."""
        wanted = np.clip(BEND_PART / np.maximum(self._bends, 1e-6), CLOSEST_SPACING, SECTION_SPACING)
        wanted = np.where(self._meeting, np.minimum(wanted, CLOSE_SPACING), wanted)
        wanted = minimum_filter1d(wanted, 9, mode=self._mode)
        wanted = uniform_filter1d(wanted, 5, mode=self._mode)
        density = 0.5 * (1.0 / wanted[:-1] + 1.0 / wanted[1:]) * self._step
        number = np.concatenate([[0.0], np.cumsum(density)])
        count = max(8, int(np.ceil(number[-1])))
        return np.interp(np.linspace(0.0, number[-1], count + 1), number, self._table_s)

    # ---- by place ----------------------------------------------------------------------------------------------------
    def feet(self, xy: np.ndarray) -> Feet:
        """All feet of places on the map [m], shape [n, 2], in the order of the places."""
        none = np.empty(0, dtype=np.int64)
        pairs = [(none, none)]
        for start in range(0, len(xy), 50_000):  # bounds the memory
            near = KDTree(xy[start : start + 50_000]).sparse_distance_matrix(
                self._tree, self._reach, output_type="coo_matrix"
            )
            pairs.append((near.row.astype(np.int64) + start, near.col.astype(np.int64)))
        place, sample = (np.concatenate(part) for part in zip(*pairs, strict=True))

        def ahead(of: np.ndarray) -> np.ndarray:
            return np.sum((xy[place] - self._positions[of, :2]) * self._along[of], axis=1)

        before, after = ahead(sample), ahead(sample + 1)
        passed = (before >= 0.0) & (after < 0.0)
        place, sample, before, after = place[passed], sample[passed], before[passed], after[passed]
        guess = self._table_s[sample] + self._step * before / (before - after)
        s, offset = self.centreline.closest(xy[place], near=guess)
        left, right = self.limits(s)
        inside = (offset < left) & (-offset < right) & (s >= self.start) & (s <= self.end)
        order = np.flatnonzero(inside)[np.lexsort((s[inside], place[inside]))]
        place, s, offset = place[order], s[order], offset[order]
        # In the tightest bends two samples may lead to one foot.
        again = (np.diff(place, prepend=-1) == 0) & (np.diff(s, prepend=-np.inf) < 0.1)
        return Feet(place[~again], s[~again], offset[~again])

    def blended(self, xy: np.ndarray, land: np.ndarray, feet: Feet) -> np.ndarray:
        """Heights of the ground [m], shape [n].

        Args:
            xy: Places [m], shape [n, 2].
            land: Heights of the land there [m], shape [n].
            feet: Of the places.
        """
        share = self.share(feet.s, feet.offset)
        weight = share / (_NEARNESS**2 + feet.offset**2)
        total = np.bincount(feet.place, weight, len(xy))
        road = np.bincount(feet.place, weight * self.height(feet.s, feet.offset), len(xy))
        rest = np.ones(len(xy))
        np.multiply.at(rest, feet.place, 1.0 - share)
        road = np.divide(road, total, out=land.copy(), where=total > 0.0)
        return land + (1.0 - rest) * (road - land)


def _smooth_fall(part: np.ndarray) -> np.ndarray:
    """1 up to 0, 0 from 1 on, smooth up to the second derivative."""
    t = np.clip(part, 0.0, 1.0)
    return 1.0 - t**3 * (10.0 + t * (6.0 * t - 15.0))


HeightOf = Callable[[np.ndarray], np.ndarray]
"""Heights [m], shape [...], of places on the map [m], shape [..., 2]."""
