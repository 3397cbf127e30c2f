"""The road along a GPS track.

    read  ->  project  ->  drop repeats and stops  ->  close  ->  smooth in plan  ->  ease corners  ->  smooth heights

* **Noise** in position and in height is smoothed without moving any point farther than `smooth`; see
  `track_smoothing`. What the track does where it turns more tightly than a bicycle can is replaced by arcs; see
  `corner_easing`.
* **Meeting itself**: where the track crosses itself, or goes out and back along one road, its heights are made one,
  for the ground has one height everywhere: a bridge becomes a crossing. How far that moved them is reported.
* **Closing**: a track that ends near its start is a closed course. What it rode past its start is cut off, and the
  difference of heights, the drift of a barometer, is spread over the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from echelon.errors import InputError
from echelon.settings import shown
from echelon.terrain.corner_easing import bending, eased
from echelon.terrain.spline import Centreline
from echelon.terrain.track_cleaning import CleanTrack, along_of, clean_track
from echelon.terrain.track_smoothing import felt_by, meeting_count, meetings, smoothed

SMOOTH = 5.0
"""By default no point of a track is moved farther than this, neither on the map nor in height [m]."""

GAP = 300.0
"""By default points of a track may be this far apart [m]; receivers leave out what lies straight between others."""

CLOSE = 50.0
"""By default a track that ends within this of its start is closed [m]."""

WIDTH, VERGE = 6.0, 1.5
"""Of a road of which a track says nothing [m]."""

LEAST_RADIUS = 6.0
"""Tighter corners are eased: about the smallest circle that a racing bicycle rides at ease [m]."""

_STEP, _STEPS = 1.0, 50_000  # [m], at which a track is worked on, and how many at most; longer ones have longer steps
_PLAN_LENGTH, _HEIGHT_LENGTH = 10.0, 40.0  # [m]: waves shorter than about six times this go, if the bound allows
_KINK_LENGTH = 2.0  # [m], likewise, of where arcs begin and end
_ROUNDS = 6  # of coming nearer to the track, and of easing corners more


@dataclass(frozen=True)
class RoadLine:
    """The line of a road, and how far it is from the track.

    Attributes:
        points: For the spline [m], shape [n, 3]
        radius: Least radius anywhere [m].
        corners: That were too tight to ride, and were eased.
        moved_corner: How far any of them moved the line [m].
        meetings: Places or stretches where the track meets itself.
        moved_meeting: How far heights were moved to be one there [m].
        moved_plan: How far any point was moved on the map, eased corners left out [m].
        moved_height: How far any was moved in height, drift, eased corners and meetings left out [m].
    """

    points: np.ndarray
    radius: float
    corners: int
    moved_corner: float
    meetings: int
    moved_meeting: float
    moved_plan: float
    moved_height: float


@dataclass(frozen=True)
class TrackRoad:
    """A road along a track.

    Attributes:
        path: Of the track's file.
        track: What it was made of.
        line: The line of the road.
        width: Of the road [m].
        verge: Beside each of its edges [m].
        smooth: No point was to be moved farther than this by smoothing, on the map or in height [m].
    """

    path: Path
    track: CleanTrack
    line: RoadLine
    width: float
    verge: float
    smooth: float


def road_along(
    path: str | Path,
    *,
    width: float = WIDTH,
    smooth: float = SMOOTH,
    gap: float = GAP,
    close: float = CLOSE,
    track: int = 0,
) -> TrackRoad:
    """Lay a road along the track of a GPX file.

    Args:
        path: Of the file.
        width: Of the road [m].
        smooth: Greatest distance that smoothing may move a point, on the map and in height [m].
        gap: Greatest distance between points that follow on one another [m].
        close: A track that ends within this of its start is closed [m]; 0 leaves all open.
        track: Which track of the file, counted from 1; 0 takes the only one.

    Raises:
        InputError: One line that names the file, what is wrong, where in it, and what is allowed.
    """
    limits = (
        ("width", width, 2.0, 30.0), ("smooth", smooth, 0.5, 100.0), ("gap", gap, 1.0, 5000.0),
        ("close", close, 0.0, 500.0),
    )  # fmt: skip
    for option, value, low, high in limits:
        if not low <= value <= high:
            raise InputError(f"{option} = {value:g}: must be from {low:g} to {high:g} m")
    path = Path(path)
    where = str(path) if str(path).isprintable() else shown(str(path))
    cleaned = clean_track(path, where, smooth, gap, close, track)
    return TrackRoad(path, cleaned, _line_along(cleaned, where, smooth, width), width, VERGE, smooth)


# ---- its line --------------------------------------------------------------------------------------------------------
def _line_along(track: CleanTrack, where: str, smooth: float, width: float) -> RoadLine:
    """Smooth a track, ease its corners, make its heights one where it meets itself.

    Smoothing holds its bound at the places that it works on. The track's own points lie between those, easing comes
    after it, and so does the spline: what is then still out of bounds is taken off them, and it is all done again.
    """
    radius = max(LEAST_RADIUS, 0.5 * width + VERGE + 0.75)
    plan_bound, height_bound, eased_radius = smooth, smooth, radius
    for remaining in reversed(range(_ROUNDS)):
        try:
            line = _laid(track, plan_bound, height_bound, eased_radius, width)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        if remaining == 0 or (max(line.moved_plan, line.moved_height) <= smooth and line.radius >= 0.98 * radius):
            return line
        plan_bound = max(plan_bound - 1.1 * max(line.moved_plan - smooth, 0.0), 0.1 * smooth)
        height_bound = max(height_bound - 1.1 * max(line.moved_height - smooth, 0.0), 0.1 * smooth)
        eased_radius = min(eased_radius * max(1.02 * radius / line.radius, 1.0), 1.5 * radius)
    raise AssertionError("unreachable")


def _laid(track: CleanTrack, plan_bound: float, height_bound: float, radius: float, width: float) -> RoadLine:
    """A line along a track, its tight corners eased to a radius [m]."""
    closed = track.closed
    line = _evened(track)
    step = track.length / (len(line) if closed else len(line) - 1)
    ways = eased(smoothed(line[:, :2], step, _PLAN_LENGTH, plan_bound, closed), step, radius, closed)
    plan = smoothed(ways.places, step, _KINK_LENGTH, min(plan_bound, 0.3), closed)

    source = np.unwrap(ways.source, period=len(line)) if closed else ways.source
    around = np.append(line[:, 2], line[0, 2]) if closed else line[:, 2]
    raw = np.interp(source % len(line) if closed else source, np.arange(len(around)), around)
    pairs = meetings(plan, step, 0.5 * width, 4.0 * width, closed)
    heights = smoothed(raw[:, None], step, _HEIGHT_LENGTH, height_bound, closed, pairs)[:, 0]
    felt = felt_by(pairs, len(raw), step, _HEIGHT_LENGTH, closed)

    points = np.round(_chosen(np.column_stack([plan, heights]), closed), 3)
    spline = Centreline(points, closed)
    lengths = along_of(plan)
    moved_plan, moved_height = _moved(
        spline, track, step, source, lengths * (spline.length / lengths[-1]), ways.fresh, felt
    )
    sharpest = float(np.abs(spline.curvature(np.arange(0.0, spline.length, 0.5))).max())
    return RoadLine(
        points=points,
        radius=1.0 / max(sharpest, 1e-9),
        corners=ways.corners,
        moved_corner=ways.moved,
        meetings=meeting_count(pairs, step, 4.0 * width),
        moved_meeting=float(np.abs(heights - raw)[felt].max(initial=0.0)),
        moved_plan=moved_plan,
        moved_height=moved_height,
    )


def _evened(track: CleanTrack) -> np.ndarray:
    """A track at even steps, shape [n, 3]."""
    count = max(8, min(round(track.length / _STEP), _STEPS))
    along, places = track.along, track.places
    if track.closed:
        asked = np.arange(count) * (track.length / count)
        along, places = np.append(along, track.length), np.vstack([places, places[:1]])
    else:
        asked = np.linspace(0.0, track.length, count + 1)
    return np.stack([np.interp(asked, along, places[:, axis]) for axis in range(3)], axis=1)


def _chosen(road: np.ndarray, closed: bool) -> np.ndarray:
    """Points for a spline: near to one another in bends, farther apart along the straights, shape [m, 3]."""
    around = np.vstack([road, road[:1]]) if closed else road
    runs = np.hypot(*np.diff(around[:, :2], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(runs)])
    bends = bending(road[:, :2], closed)
    wish = np.clip(0.25 / np.maximum(bends, 1e-6), 1.5, 12.0)
    wish = np.append(wish, wish[0]) if closed else wish
    # Neither may a gap be much longer than the one beside it: twice round, so that a seam does not show.
    laps = 3 if closed else 1
    place = np.concatenate([along[:-1] + lap * along[-1] for lap in range(laps)] + [[laps * along[-1]]])
    long = np.concatenate([np.tile(wish[:-1], laps), wish[-1:]])
    long = np.minimum.accumulate(long - 0.25 * place) + 0.25 * place
    long = (np.minimum.accumulate((long + 0.25 * place)[::-1]) - 0.25 * place[::-1])[::-1]
    middle = long[len(road) : 2 * len(road) + 1] if closed else long
    density = np.concatenate([[0.0], np.cumsum(runs * 0.5 * (1.0 / middle[1:] + 1.0 / middle[:-1]))])
    count = max(8, round(density[-1]))
    asked = np.arange(count if closed else count + 1) * (density[-1] / count)
    at = np.interp(asked, density, along)
    # Straight pieces between the fine places would make corners of what is round.
    return CubicSpline(along, around, bc_type="periodic" if closed else "natural")(at)


def _moved(
    spline: Centreline,
    track: CleanTrack,
    step: float,
    source: np.ndarray,
    expected: np.ndarray,
    fresh: np.ndarray,
    felt: np.ndarray,
) -> tuple[float, float]:
    """How far points of a track were moved on the map and in height [m], where nothing but smoothing moved them.

    Args:
        spline: Of the course.
        track: What it was made of.
        step: Of the evened track [m].
        source: Of places along the course, those on the evened track that they stand for, shape [n].
        expected: Arc lengths of the same places, about [m], shape [n].
        fresh: Which of them belong to an eased corner, shape [n].
        felt: The heights of which were moved by a meeting, shape [n].
    """
    order = np.argsort(source, kind="stable")
    source, expected, fresh, felt = source[order], expected[order], fresh[order], felt[order]
    place = track.along / step
    if track.closed:  # the course need not begin just where the track does
        lap = track.length / step
        place = source[0] + (place - source[0]) % lap
        source, expected = np.append(source, source[0] + lap), np.append(expected, expected[0] + spline.length)
        fresh, felt = np.append(fresh, fresh[0]), np.append(felt, felt[0])
    s, offset = spline.closest(track.places[:, :2], near=np.interp(place, source, expected))
    rise = np.abs(spline.position(s)[:, 2] - track.places[:, 2])

    def clear_of(those: np.ndarray) -> np.ndarray:
        return np.interp(place, source, those.astype(np.float64)) == 0.0

    on_map, in_height = clear_of(fresh), clear_of(fresh | felt)
    return float(np.abs(offset)[on_map].max(initial=0.0)), float(rise[in_height].max(initial=0.0))
