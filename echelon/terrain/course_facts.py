"""What there is to say about a course in numbers: length, climbing, grades, corners, climbs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from echelon.terrain.course import Course

CORNER_RADIUS, CORNER_ANGLE = 40.0, 0.5
"""A bend is a corner if its radius comes below this [m] and it turns by at least this [rad]."""

BEND_RADIUS = 150.0
"""A bend is where the radius is less than this [m]."""

CLIMB_GRADE, CLIMB_RISE, CLIMB_REST = 0.02, 5.0, 60.0
"""A climb is steeper than this but for stretches of at most the last [m], and rises by at least the second [m]."""

_STEP = 0.5  # [m]


@dataclass(frozen=True)
class Corner:
    """A sharp bend.

    Attributes:
        s: Of its sharpest place [m].
        angle: By how much it turns, positive to the left [rad].
        radius: Least [m].
    """

    s: float
    angle: float
    radius: float


@dataclass(frozen=True)
class Climb:
    """A stretch that goes up.

    Attributes:
        s: Where it begins [m].
        length: [m].
        rise: [m].
        steepest: Rise over run.
    """

    s: float
    length: float
    rise: float
    steepest: float


@dataclass(frozen=True)
class CourseFacts:
    """A lap in numbers.

    Attributes:
        length: Of the centreline in space [m].
        climb, descent: Sums of all rises and of all falls [m].
        lowest, highest: Heights [m].
        steepest_up, steepest_down: Greatest and least grade, rise over run.
        sharpest: Least radius in plan [m].
        crest: Least radius of a crest or a dip [m].
        counter_clockwise: Which way round it goes; None of an open course.
        corners: In the order of riding.
        climbs: In the order of riding.
    """

    length: float
    climb: float
    descent: float
    lowest: float
    highest: float
    steepest_up: float
    steepest_down: float
    sharpest: float
    crest: float
    counter_clockwise: bool | None
    corners: tuple[Corner, ...]
    climbs: tuple[Climb, ...]

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self) | {
            "corners": [asdict(corner) for corner in self.corners],
            "climbs": [asdict(climb) for climb in self.climbs],
        }


def course_facts(course: Course) -> CourseFacts:
    """Measure a course along its centreline."""
    line = course.centreline
    count = max(8, round(line.length / _STEP))
    s = np.linspace(0.0, line.length, count, endpoint=not course.closed)
    step = line.length / (count if course.closed else count - 1)
    places, grades, bends = line.position(s), line.grade(s), line.curvature(s)
    heights = places[:, 2]
    rises = np.diff(np.append(heights, heights[0]) if course.closed else heights)
    area = 0.5 * float(np.sum(places[:, 0] * np.roll(places[:, 1], -1) - np.roll(places[:, 0], -1) * places[:, 1]))
    vertical = np.abs(np.diff(grades)) / step
    return CourseFacts(
        length=line.length,
        climb=float(np.maximum(rises, 0.0).sum()),
        descent=float(np.maximum(-rises, 0.0).sum()),
        lowest=float(heights.min()),
        highest=float(heights.max()),
        steepest_up=float(grades.max()),
        steepest_down=float(grades.min()),
        sharpest=1.0 / max(float(np.abs(bends).max()), 1e-9),
        crest=1.0 / max(float(vertical.max()), 1e-9),
        counter_clockwise=area > 0.0 if course.closed else None,
        corners=_corners(s, step, bends),
        climbs=_climbs(s, step, heights, grades),
    )


def _corners(s: np.ndarray, step: float, bends: np.ndarray) -> tuple[Corner, ...]:
    found: list[Corner] = []
    for way in (1.0, -1.0):
        for first, after in _runs(way * bends > 1.0 / BEND_RADIUS):
            angle = float(bends[first:after].sum()) * step
            at = first + int(np.abs(bends[first:after]).argmax())
            if abs(angle) >= CORNER_ANGLE and abs(bends[at]) > 1.0 / CORNER_RADIUS:
                found.append(Corner(float(s[at]), angle, 1.0 / abs(float(bends[at]))))
    return tuple(sorted(found, key=lambda corner: corner.s))


def _climbs(s: np.ndarray, step: float, heights: np.ndarray, grades: np.ndarray) -> tuple[Climb, ...]:
    up = grades > CLIMB_GRADE
    for first, after in _runs(~up):
        if (after - first) * step <= CLIMB_REST and first > 0 and after < len(up):
            up[first:after] = True
    return tuple(
        Climb(float(s[first]), (after - first) * step, float(heights[after - 1] - heights[first]), steepest)
        for first, after in _runs(up)
        for steepest in [float(grades[first:after].max())]
        if heights[after - 1] - heights[first] >= CLIMB_RISE
    )


def _runs(which: np.ndarray) -> list[list[int]]:
    """First and one past the last index of each run of what is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], which.astype(np.int8), [0]])))
    return edges.reshape(-1, 2).tolist()
