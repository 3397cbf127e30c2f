"""A GPS track as a course to ride. How the road is laid is in `track_road`.

Nothing is dropped or invented in silence: everything that was done is in the `ImportReport`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from echelon.terrain.course import Course
from echelon.terrain.track_road import CLOSE, GAP, SMOOTH, WIDTH, TrackRoad, road_along

RIDEABLE = 0.15
"""Steeper than this is reported: the riders climb 13 %."""


@dataclass(frozen=True)
class ImportReport:
    """What was done to a track; lengths in metres.

    Attributes:
        points: Points read.
        dropped: Of those, repeats and points of stops.
        cut: Of those, past the start of a closed course.
        filled_heights: Heights interpolated because they were missing.
        closed: Whether the course is closed.
        closing_gap: From the last point to the first, of a closed one.
        height_drift: Difference of heights that was spread over a closed one.
        bound: No point was to be moved farther than this by smoothing, on the map or in height.
        moved_plan: How far any point was moved on the map, eased corners left out.
        moved_height: How far any was moved in height, drift, eased corners and meetings left out.
        corners_eased: Corners that were too tight to ride.
        least_radius: Of the course's sharpest bend.
        moved_corner: How far any of them moved the line.
        meetings: Places or stretches where the track meets itself.
        moved_meeting: How far heights were moved to be one there.
        length: Of the course.
        climb: Sum of all rises in a lap.
        steepest_up, steepest_down: Greatest and least grade, rise over run.
        latitude, longitude: Of the origin of the course [degrees].
    """

    points: int
    dropped: int
    cut: int
    filled_heights: int
    closed: bool
    closing_gap: float
    height_drift: float
    bound: float
    moved_plan: float
    moved_height: float
    corners_eased: int
    least_radius: float
    moved_corner: float
    meetings: int
    moved_meeting: float
    length: float
    climb: float
    steepest_up: float
    steepest_down: float
    latitude: float
    longitude: float

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)

    def lines(self) -> list[str]:
        """In words, a line for each thing that was done."""
        kind = "closed" if self.closed else "open"
        said = [f"{self.points} points; {kind} course of {self.length:.0f} m, {self.climb:.0f} m of climbing"]
        if self.dropped:
            said.append(f"dropped {_times(self.dropped, 'point')} that repeated one or belonged to a stop")
        if self.filled_heights:
            said.append(f"interpolated {_times(self.filled_heights, 'missing height')}")
        if self.closed:
            cut = f"cut {_times(self.cut, 'point')} past the start, " if self.cut else ""
            said.append(f"{cut}closed a gap of {self.closing_gap:.1f} m, spread {self.height_drift:+.1f} m of drift")
        said.append(
            f"smoothed: no point moved more than {self.moved_plan:.2f} m on the map and {self.moved_height:.2f} m in "
            f"height (bound {self.bound:g} m)"
        )
        if self.corners_eased:
            said.append(
                f"eased {_times(self.corners_eased, 'corner')}, to a radius of {self.least_radius:.1f} m at least, "
                f"which moved the line by up to {self.moved_corner:.1f} m"
            )
        if self.meetings:
            said.append(
                f"meets itself in {_times(self.meetings, 'place')}: made the heights one there, moving them by up to "
                f"{self.moved_meeting:.1f} m"
            )
        said.append(f"grades from {100 * self.steepest_down:+.1f} % to {100 * self.steepest_up:+.1f} %")
        if max(self.steepest_up, -self.steepest_down) > RIDEABLE:
            said.append(f"steeper than {100 * RIDEABLE:g} %: riders may stall or fall there; more smoothing may help")
        return said


def _times(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


@dataclass(frozen=True)
class Imported:
    """A course made of a track, and what was done."""

    course: Course
    report: ImportReport


def import_track(
    path: str | Path,
    *,
    name: str = "",
    width: float = WIDTH,
    smooth: float = SMOOTH,
    gap: float = GAP,
    close: float = CLOSE,
    track: int = 0,
) -> Imported:
    """Make a course of a GPX file.

    Args:
        path: Of the file.
        name: Of the course; by default the file's.
        width: Of the road [m].
        smooth: Greatest distance that smoothing may move a point, on the map and in height [m].
        gap: Greatest distance between points that follow on one another [m].
        close: A track that ends within this of its start is closed [m]; 0 leaves all open.
        track: Which track of the file, counted from 1; 0 takes the only one.

    Raises:
        InputError: One line that names the file, what is wrong, where in it, and what is allowed.
    """
    road = road_along(path, width=width, smooth=smooth, gap=gap, close=close, track=track)
    course = Course.along(road, name)
    return Imported(course, _report(road, course))


def _report(road: TrackRoad, course: Course) -> ImportReport:
    track, laid, line = road.track, road.line, course.centreline
    s = np.arange(0.0, line.length, 0.5)
    grades, profile = line.grade(s), line.position(s)[:, 2]
    rises = np.diff(np.append(profile, profile[0]) if course.closed else profile)
    return ImportReport(
        points=track.points,
        dropped=track.points - len(track.places) - track.cut,
        cut=track.cut,
        filled_heights=track.filled,
        closed=track.closed,
        closing_gap=track.closing_gap,
        height_drift=track.drift,
        bound=road.smooth,
        moved_plan=laid.moved_plan,
        moved_height=laid.moved_height,
        corners_eased=laid.corners,
        least_radius=laid.radius,
        moved_corner=laid.moved_corner,
        meetings=laid.meetings,
        moved_meeting=laid.moved_meeting,
        length=line.length,
        climb=float(np.maximum(rises, 0.0).sum()),
        steepest_up=float(grades.max()),
        steepest_down=float(grades.min()),
        latitude=track.origin[0],
        longitude=track.origin[1],
    )
