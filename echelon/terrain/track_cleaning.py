"""A GPS track on the map, without repeats and stops, its missing heights filled, closed where it comes back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from echelon.errors import InputError
from echelon.terrain.gpx import read_gpx
from echelon.terrain.map_projection import EXTENT, projected

MISSING_SHARE, MISSING_RUN = 0.1, 300.0
"""Missing heights are interpolated where they are at most this part of all, and at most this far on end [m]."""

DRIFT = 20.0
"""Greatest difference of heights between end and start of a closed track [m]."""

_STOP_POINTS = 5  # on end within the bound of the first: a stop
_REPEAT = 1.0  # [m], nearer points repeat the last
_SHORTEST = 100.0  # [m], of a course


@dataclass(frozen=True)
class CleanTrack:
    """A track on the map, cleaned and closed, its noise still in it.

    Attributes:
        title: Of the track in its file.
        origin: Latitude and longitude [degrees].
        points: How many there were in the file.
        places: Those that are kept [m],                    shape [n, 3]
        along: How far along the track each of them is [m], shape [n]
        closed: Whether its last point is followed by its first.
        closing_gap: Between those, of a closed one [m].
        cut: Points past the start that were cut off.
        drift: Of heights, spread over a closed one [m].
        filled: Heights that were missing and are interpolated.
    """

    title: str
    origin: tuple[float, float]
    points: int
    places: np.ndarray
    along: np.ndarray
    closed: bool
    closing_gap: float
    cut: int
    drift: float
    filled: int

    @property
    def length(self) -> float:
        """With the gap that closes it [m]."""
        return float(self.along[-1]) + self.closing_gap


def clean_track(path: Path, where: str, smooth: float, gap: float, close: float, track: int) -> CleanTrack:
    """Read a track and clean it; arguments as of `track_road.road_along`, `where` names the file in messages.

    Raises:
        InputError: One line that names the file, what is wrong, where in it, and what is allowed.
    """
    recorded = read_gpx(path, where, track)
    known = np.isfinite(recorded.heights)
    height = float(recorded.heights[known].mean()) if known.any() else 0.0
    origin, flat = projected(recorded.latitude, recorded.longitude, height)
    far = np.flatnonzero(np.isnan(flat[:, 0]))
    if len(far):
        raise InputError(
            f"{where}: point {far[0] + 1} is more than {EXTENT / 1000:g} km from point 1; must be within that distance"
        )
    heights, filled = _filled(flat, recorded.heights, where)
    kept = _moving(flat, smooth)
    flat, heights = flat[kept], heights[kept]
    runs = np.hypot(*np.diff(flat, axis=0).T)
    if len(flat) < 4 or runs.sum() < _SHORTEST:
        raise InputError(
            f"{where}: the track is {runs.sum():.0f} m long with {len(flat)} different points; must be at least "
            f"{_SHORTEST:g} m with 4"
        )
    if runs.max() > gap:
        at = int(runs.argmax())
        raise InputError(
            f"{where}: gap of {runs[at]:.0f} m from point {kept[at] + 1} to point {kept[at + 1] + 1}; must be at most "
            f"{gap:g} m"
        )
    last = _closing_point(flat, close)
    closed = last is not None
    cut = len(flat) - 1 - last if last is not None else 0
    flat, heights = flat[: len(flat) - cut], heights[: len(flat) - cut]
    along = along_of(flat)
    closing_gap = float(np.hypot(*(flat[0] - flat[-1]))) if closed else 0.0
    drift = _drift(float(heights[-1] - heights[0]), closing_gap, where) if closed else 0.0
    places = np.column_stack([flat, heights - drift * along / along[-1]])
    return CleanTrack(recorded.title, origin, len(recorded), places, along, closed, closing_gap, cut, drift, filled)


def along_of(line: np.ndarray) -> np.ndarray:
    """How far along a line on the map each of its places is [m], shape [n]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])


def _filled(flat: np.ndarray, heights: np.ndarray, where: str) -> tuple[np.ndarray, int]:
    """Heights with the missing ones interpolated along the way [m], and how many those were."""
    missing = ~np.isfinite(heights)
    count = int(missing.sum())
    if not count:
        return heights, 0
    if count == len(heights):
        raise InputError(f"{where}: none of its {count} points has a height (ele); must have them, for the hills")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(flat, axis=0).T))])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
    for first, after in edges.reshape(-1, 2).tolist():
        run = along[min(after, len(along) - 1)] - along[max(first - 1, 0)]
        if run > MISSING_RUN:
            raise InputError(
                f"{where}: heights (ele) of points {first + 1} to {after} are missing, along {run:.0f} m; must be "
                f"missing along at most {MISSING_RUN:g} m"
            )
    if count > MISSING_SHARE * len(heights):
        raise InputError(
            f"{where}: heights (ele) of {count} of {len(heights)} points are missing, the first of point "
            f"{int(missing.argmax()) + 1}; must be at most one in {1 / MISSING_SHARE:.0f}"
        )
    return np.interp(along, along[~missing], heights[~missing]), count


def _moving(flat: np.ndarray, smooth: float) -> np.ndarray:
    """Indices of points that get on: without repeats, and with one point for each stop."""
    kept = [0]
    index = 1
    while index < len(flat):
        last = flat[kept[-1]]
        after = index
        while after < len(flat) and np.hypot(*(flat[after] - last)) < max(smooth, _REPEAT):
            after += 1
        if after - index >= _STOP_POINTS or np.hypot(*(flat[index] - last)) < _REPEAT:
            index = after if after - index >= _STOP_POINTS else index + 1
            continue
        kept.append(index)
        index += 1
    return np.array(kept)


def _closing_point(flat: np.ndarray, close: float) -> int | None:
    """Index of the last point of a closed course, from which it goes on to the first; None of an open one."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(flat, axis=0).T))])
    gaps = np.hypot(*(flat - flat[0]).T)
    tail = np.flatnonzero((along > max(0.75 * along[-1], 4.0 * close)) & (along > along[-1] - 400.0))
    tail = tail[tail >= 3]
    if not len(tail) or gaps[tail].min() > close:
        return None
    last = int(tail[gaps[tail].argmin()])
    # Not past the start, nor on it: the way from the last point to the first shall lead forward.
    away = flat[int(np.argmax(gaps > max(10.0, _REPEAT)))] - flat[0]
    came = flat[last] - flat[last - 1]
    forward = float(came @ away) > 0.0
    while (
        last > 3
        and gaps[last] <= close
        and (gaps[last] < 2.0 * _REPEAT or (forward and float((flat[0] - flat[last]) @ away) <= 0.0))
    ):
        last -= 1
    return last


def _drift(difference: float, gap: float, where: str) -> float:
    """How much of the difference between the last height and the first is not the slope of the gap [m]."""
    drift = math.copysign(max(abs(difference) - 0.1 * gap, 0.0), difference)
    if abs(drift) > DRIFT:
        raise InputError(
            f"{where}: ends {gap:.0f} m from its start but {difference:+.0f} m higher; must be within {DRIFT:g} m, or "
            "left open, with --close 0 or close=0"
        )
    return drift
