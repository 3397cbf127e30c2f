"""Corners that are too tight to ride, and turns on the spot, replaced by arcs that are not.

Where a line bends more sharply than a bicycle turns, the stretch around the place is replaced by the shortest way of
that turning circle between a pose before it and a pose behind it (Dubins 1957). Those ways are made of at most three
pieces, left and right arcs and straights: a street corner becomes an arc, a turn on the spot, out and back along one
road, the bulb that a rider swings out and back for. Of the stretches that can be replaced the one is taken whose
replacement stays nearest to the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from echelon.errors import InputError

_MARGIN = 1.08  # radius of the arcs, relative to the least that is allowed: room for the spline through points of them
_ROUNDS = 40
_REACHES = np.arange(0.5, 6.01, 0.25)  # radii before and behind a corner, tried one by one


@dataclass(frozen=True)
class Eased:
    """A line without tight corners.

    Attributes:
        places: At about even steps [m], shape [n, 2].
        source: For each the place on the line it was made of that it stands for, an index with fractions, shape [n].
        fresh: Which of them belong to a corner that was eased, shape [n].
        corners: How many were eased.
        moved: How far any of them moved the line [m].
    """

    places: np.ndarray
    source: np.ndarray
    fresh: np.ndarray
    corners: int
    moved: float


def eased(places: np.ndarray, step: float, radius: float, closed: bool) -> Eased:
    """The line with every corner at least as wide as a radius.

    Args:
        places: On the map, at even steps [m], shape [n, 2].
        step: Between them [m].
        radius: Least radius [m].
        closed: Whether the last is followed by the first.

    Raises:
        InputError: A corner cannot be eased; the message says how far along, without naming the file.
    """
    line = np.asarray(places, dtype=np.float64)
    source = np.arange(len(line), dtype=np.float64)
    fresh = np.zeros(len(line), dtype=bool)
    corners, moved = 0, 0.0
    for _ in range(_ROUNDS * max(1, len(line) // 500)):
        bends = bending(line, closed)
        at = int(bends.argmax())
        if bends[at] * radius <= 1.0:
            if closed:  # back to where it began
                first = int(np.where(fresh, np.inf, np.abs(source)).argmin())
                line, source, fresh = (np.roll(array, -first, axis=0) for array in (line, source, fresh))
            return Eased(line, source, fresh, corners, moved)
        count = len(line)
        if closed:  # the corner into the middle, away from the seam
            shift = at - count // 2
            line = np.roll(line, -shift, axis=0)
            source, fresh = np.roll(source, -shift), np.roll(fresh, -shift)
            at = count // 2
        best: tuple[float, int, int, np.ndarray] | None = None
        for reach in _REACHES * radius:
            low, high = at - math.ceil(reach / step), at + math.ceil(reach / step)
            if low < 1 or high > count - 2:
                continue
            way = _shortest_way(line, low, high, _MARGIN * radius, step)
            gap = _farthest(way, line[low : high + 1])
            # A longer stretch has to be clearly better: it changes more of the track.
            if best is None or gap < 0.9 * best[0]:
                best = (gap, low, high, way)
        if best is None:
            raise InputError(f"the corner {at * step:.0f} m along is too near to an end of the track to be eased")
        gap, low, high, way = best
        ahead = np.unwrap(source[[low, high]], period=len(places)) if closed else source[[low, high]]
        line = np.vstack([line[:low], way, line[high + 1 :]])
        source = np.concatenate([source[:low], np.linspace(ahead[0], ahead[1], len(way)), source[high + 1 :]])
        fresh = np.concatenate([fresh[:low], np.ones(len(way), dtype=bool), fresh[high + 1 :]])
        corners, moved = corners + 1, max(moved, gap)
    raise InputError(
        f"the corner {source[int(bending(line, closed).argmax())] * step:.0f} m along cannot be eased to a radius of "
        f"{radius:g} m: the track is too tangled there"
    )


def bending(line: np.ndarray, closed: bool) -> np.ndarray:
    """Curvature at each place of a line, that of the circle through it and its neighbours [1/m], shape [n].

    A turn on the spot, and places that coincide, bend without limit.
    """
    before, after = np.roll(line, 1, axis=0), np.roll(line, -1, axis=0)
    a, b, c = line - before, after - line, after - before
    cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    sides = np.hypot(*a.T) * np.hypot(*b.T) * np.hypot(*c.T)
    back = np.einsum("ij,ij->i", a, b) <= 0.0
    bends = np.where(back | (sides < 1e-12), 1e9, 2.0 * cross / np.maximum(sides, 1e-12))
    if not closed:
        bends[[0, -1]] = 0.0
    return bends


def _farthest(way: np.ndarray, line: np.ndarray) -> float:
    """Greatest distance from either of two lines to the other [m]."""
    return float(max(KDTree(line).query(way)[0].max(), KDTree(way).query(line)[0].max()))


# ---- the shortest way ------------------------------------------------------------------------------------------------
def _shortest_way(line: np.ndarray, low: int, high: int, radius: float, step: float) -> np.ndarray:
    """Places from line[low] to line[high] along the shortest way that leaves and arrives as the line does."""
    start, end = line[low], line[high]
    heading = math.atan2(*(line[low] - line[low - 1])[::-1])
    arrival = math.atan2(*(line[high + 1] - line[high])[::-1])
    pieces = _dubins(start, heading, end, arrival, radius)
    length = sum(size * (radius if turn else 1.0) for turn, size in pieces)
    count = max(2, round(length / step))
    asked = np.linspace(0.0, length, count + 1)
    way = np.empty((count + 1, 2))
    place, direction, done = start.copy(), heading, 0.0
    for turn, size in pieces:
        run = size * (radius if turn else 1.0)
        inside = (asked >= done - 1e-9) & (asked <= done + run + 1e-9)
        u = asked[inside] - done
        if turn:
            angle = direction + turn * u / radius
            way[inside] = place + turn * radius * np.stack(
                [np.sin(angle) - math.sin(direction), math.cos(direction) - np.cos(angle)], axis=1
            )
            last = direction + turn * size
            place = place + turn * radius * np.array(
                [math.sin(last) - math.sin(direction), math.cos(direction) - math.cos(last)]
            )
            direction = last
        else:
            along = np.array([math.cos(direction), math.sin(direction)])
            way[inside] = place + u[:, None] * along
            place = place + run * along
        done += run
    way[0], way[-1] = start, end
    return way


def _dubins(
    start: np.ndarray, heading: float, end: np.ndarray, arrival: float, radius: float
) -> list[tuple[int, float]]:
    """The shortest way as (turn, size): turn 1 left, -1 right, 0 straight; size an angle [rad] or a length [m]."""
    across = (end - start) / radius
    d, theta = float(np.hypot(*across)), math.atan2(across[1], across[0])
    a, b = _turn(heading - theta), _turn(arrival - theta)
    ways: list[tuple[float, tuple[int, int, int], tuple[float, float, float]]] = []
    for first in (1, -1):
        # Three formulas for six kinds of ways: in a mirror a right turn is a left one. Left, straight, left; left,
        # straight, right; left, right, left (Shkel & Lumelsky 2001).
        p, q = first * a, first * b
        sin_p, cos_p, sin_q, cos_q, cos_pq = math.sin(p), math.cos(p), math.sin(q), math.cos(q), math.cos(p - q)
        sizes: list[tuple[int, tuple[float, float, float]]] = []
        # A distance between two centres, so negative by rounding at most.
        straight = math.sqrt(max(2.0 + d * d - 2.0 * cos_pq + 2.0 * d * (sin_p - sin_q), 0.0))
        tangent = math.atan2(cos_q - cos_p, d + sin_p - sin_q)
        sizes.append((0, (_turn(tangent - p), straight, _turn(q - tangent))))
        ratio = (6.0 - d * d + 2.0 * cos_pq + 2.0 * d * (sin_q - sin_p)) / 8.0
        if abs(ratio) <= 1.0:
            middle = 2.0 * math.pi - math.acos(ratio)
            opening = _turn(tangent - p + 0.5 * middle)
            sizes.append((-first, (opening, middle, _turn(q - p - opening + middle))))
        ways += [(sum(size), (first, turn, first), size) for turn, size in sizes]
        square = d * d - 2.0 + 2.0 * cos_pq + 2.0 * d * (sin_p + sin_q)
        if square >= 0.0:
            straight = math.sqrt(square)
            tangent = math.atan2(-cos_p - cos_q, d + sin_p + sin_q) - math.atan2(-2.0, straight)
            size = (_turn(tangent - p), straight, _turn(tangent - q))
            ways.append((sum(size), (first, 0, -first), size))
    _, turns, sizes_of_best = min(ways)
    return [(turn, size if turn else size * radius) for turn, size in zip(turns, sizes_of_best, strict=True)]


def _turn(angle: float) -> float:
    """An angle within 0 and 2 pi; one that is a whole turn but for rounding is none."""
    inside = angle % (2.0 * math.pi)
    return 0.0 if inside > 2.0 * math.pi - 1e-9 else inside
