"""A page about a ride: where the course goes and, along its profile, how everybody rode it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from echelon.export.plot_page import FAINT, INK, RED, finish, line_colors, new_page, sampled_frames
from echelon.recording import Recording
from echelon.terrain.course import Course
from echelon.terrain.spline import Centreline

STEEP = 0.10  # grade at which the colours of the profile end
_GRADES = LinearSegmentedColormap.from_list("grades", ["#2f6f9f", "#b9c3ca", "#e0a33e", "#c0182b"])
BEHIND_THE_LINE = 100.0  # [m] before the start line, from which those who start are on their first lap
_PROFILE_STEP = 5.0  # [m] from point to point of the profile, about


@dataclass(frozen=True)
class _Ride:
    """What is read of a recording, at some of its frames.

    Attributes:
        times: [s],                                              [samples]
        s: Ridden along the road, laps and all [m],              [samples, riders]
        offsets: From the centreline, left positive [m],         [samples, riders]
        speeds: [m/s],                                           [samples, riders]
        gaps: Since the first one was there [s],                 [samples, riders]
        places: Where the riders are at the end [m],             [riders, 2]
        measures: What was recorded beside, by name,             [samples, riders] each
    """

    times: np.ndarray
    s: np.ndarray
    offsets: np.ndarray
    speeds: np.ndarray
    gaps: np.ndarray
    places: np.ndarray
    measures: dict[str, np.ndarray]


def ride_page(recording: Recording) -> Figure:
    """The page of a recording whose world is a road."""
    course = Course.from_dict(recording.world["course"])
    ride = _read(recording, course.centreline)
    colors = line_colors(recording)
    figure = new_page(recording)
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.35))
    upper, lower = left.subgridspec(2, 1, height_ratios=(1.9, 1.0))
    _draw_plan(figure.add_subplot(upper), course, recording, ride, colors)
    _draw_stretch(figure.add_subplot(lower), ride, colors)
    shown = [name for name in ("power", "lean") if name in ride.measures]
    rows = right.subgridspec(4 + len(shown), 1)
    panels = [figure.add_subplot(row) for row in rows]
    low, high = float(ride.s.min()), float(ride.s.max())
    margin = 0.01 * max(high - low, 1.0)
    limits = np.array([low - margin, high + margin]) / 1000.0
    along = iter(panels)
    _draw_profile(next(along), course, limits)
    _draw_lines(next(along), ride, ride.speeds, colors, "speed", "m/s", limits)
    if "power" in shown:
        _draw_lines(next(along), ride, ride.measures["power"], colors, "power", "W", limits)
    gaps = next(along)
    _draw_lines(gaps, ride, ride.gaps, colors, "behind the first", "s", limits)
    gaps.invert_yaxis()
    offsets = next(along)
    _draw_lines(offsets, ride, ride.offsets, colors, "offset from the middle of the road, left is up", "m", limits)
    for edge in (-course.half_width, course.half_width):
        offsets.axhline(edge, color=RED, linewidth=0.9, linestyle=":")
    if "lean" in shown:
        lean = next(along)
        _draw_lines(lean, ride, np.degrees(ride.measures["lean"]), colors, "lean to the right", "deg", limits)
        lean.axhline(0.0, color=FAINT, linewidth=0.6)
    for panel in panels[:-1]:
        panel.tick_params(labelbottom=False)
    panels[-1].set_xlabel("along the road [km]")
    return figure


# ---- what is read --------------------------------------------------------------------------------------------------
def _read(recording: Recording, line: Centreline) -> _Ride:
    frames = sampled_frames(recording)
    places = np.asarray(recording.link_poses[frames, :, 0, :2], dtype=np.float64)
    names: tuple[str, ...] = recording.measure_names
    measures = np.asarray(recording.measures[frames]) if names else np.empty((*places.shape[:2], 0))
    found = {name: measures[..., index] for index, name in enumerate(names)}
    s, offsets = _along_and_across(line, places)
    times = frames / recording.frame_rate
    velocities = np.asarray(recording.velocities[frames], dtype=np.float64)
    return _Ride(
        times=times,
        s=s,
        offsets=offsets,
        speeds=np.linalg.norm(velocities, axis=2),
        gaps=_gaps(times, s),
        places=places[-1],
        measures=found,
    )


def _along_and_across(line: Centreline, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along the road, laps and all, and how far from its middle riders are [m], shape [samples, riders]."""
    s, offsets = np.empty(places.shape[:2]), np.empty(places.shape[:2])
    near: np.ndarray | None = None
    for row, now in enumerate(places):
        # Walked from sample to sample: where the road passes close to itself everybody stays on the own stretch.
        near, offsets[row] = line.closest(now, near)
        s[row] = near
    if line.closed:
        s[1:] -= line.length * np.cumsum(np.rint(np.diff(s, axis=0) / line.length), axis=0)
        # Who starts just behind the line has not ridden a lap.
        s[:, s[0] > line.length - BEHIND_THE_LINE] -= line.length
    return s, offsets


def _gaps(times: np.ndarray, s: np.ndarray) -> np.ndarray:
    """How long ago the first one passed where each rider is [s], shape [samples, riders]."""
    first = np.maximum.accumulate(s.max(axis=1))
    moved = np.concatenate([[True], np.diff(first) > 1e-6])
    passed = np.interp(s, first[moved], times[moved])
    # Before the first one's start there is no such time: as if all had ridden there at the first one's pace.
    pace = float((times[-1] - times[0]) / max(first[-1] - first[0], 1e-9)) if len(times) > 1 else 0.0
    passed -= np.maximum(first[0] - s, 0.0) * pace
    return np.maximum(times[:, None] - passed, 0.0)


# ---- panels --------------------------------------------------------------------------------------------------------
def _draw_plan(axes: Axes, course: Course, recording: Recording, ride: _Ride, colors: np.ndarray) -> None:
    for street in course.side_streets:
        axes.plot(*np.array(street).T, color=FAINT, linewidth=0.6, alpha=0.7)
    s = _along(course)
    plan = course.centreline.position(s)[:, :2]
    pieces = LineCollection(
        list(np.stack([plan[:-1], plan[1:]], axis=1)), cmap=_GRADES, norm=Normalize(-STEEP, STEEP), linewidths=2.4
    )
    pieces.set_array(course.centreline.grade(0.5 * (s[1:] + s[:-1])))
    axes.add_collection(pieces)
    start, left = course.centreline.position(0.0)[:2], course.centreline.left(0.0)
    bar = start + np.array([[-4.0], [4.0]]) * course.half_width * left
    axes.plot(*bar.T, color=INK, linewidth=1.6)
    axes.annotate(
        "start", (float(start[0]), float(start[1])), xytext=(6, 2), textcoords="offset points", fontsize=7, color=INK
    )
    axes.scatter(*ride.places.T, s=20, c=colors, edgecolors=INK, linewidths=0.5, zorder=4, label="at the end")
    for index, actor in enumerate(recording.actors):
        x, y = np.asarray(recording.actor_poses[recording.frame_count - 1])[index, :2]
        axes.plot([x], [y], marker="D", markersize=4.5, color=INK, linestyle="none", label=actor.name)
    bars = axes.figure.colorbar(pieces, ax=axes, orientation="horizontal", fraction=0.03, pad=0.02, aspect=40)
    bars.set_ticks([-STEEP, 0.0, STEEP], labels=[f"{-100 * STEEP:g} %", "grade", f"+{100 * STEEP:g} %"])
    bars.ax.tick_params(labelsize=7, colors=INK)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    finish(axes, f"{course.name}, {course.length / 1000.0:.2f} km")


def _draw_profile(axes: Axes, course: Course, limits: np.ndarray) -> None:
    """Heights along the road, lap after lap."""
    line = course.centreline
    low, high = 1000.0 * limits
    s = np.linspace(low, high, int(np.clip((high - low) / _PROFILE_STEP, 100, 4000)))
    heights = line.position(s)[:, 2]
    floor = float(heights.min()) - 0.08 * max(float(np.ptp(heights)), 5.0)
    axes.fill_between(s / 1000.0, heights, floor, color=FAINT, alpha=0.25, linewidth=0.0)
    points = np.column_stack([s / 1000.0, heights])
    pieces = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)), cmap=_GRADES, norm=Normalize(-STEEP, STEEP), linewidths=1.8
    )
    pieces.set_array(line.grade(0.5 * (s[1:] + s[:-1])))
    axes.add_collection(pieces)
    axes.set_ylim(floor, float(heights.max()) + 0.12 * max(float(np.ptp(heights)), 5.0))
    axes.set_ylabel("m")
    finish(axes, "height", limits)


def _draw_lines(
    axes: Axes, ride: _Ride, values: np.ndarray, colors: np.ndarray, title: str, unit: str, limits: np.ndarray
) -> None:
    """A line for each rider over how far it has ridden."""
    lines = np.stack([ride.s.T / 1000.0, values.T], axis=2)
    axes.add_collection(LineCollection(list(lines), colors=colors, linewidths=0.7, alpha=0.8))
    axes.autoscale_view()
    low, high = axes.get_ylim()
    if low >= 0.0 and low < 0.4 * high:
        axes.set_ylim(0.0, high)
    axes.set_ylabel(unit)
    finish(axes, title, limits)


def _draw_stretch(axes: Axes, ride: _Ride, colors: np.ndarray) -> None:
    """Metres behind the first one over time: how the group stretches and closes up."""
    behind = ride.s.max(axis=1, keepdims=True) - ride.s
    lines = np.stack([np.broadcast_to(ride.times, behind.T.shape), behind.T], axis=2)
    axes.add_collection(LineCollection(list(lines), colors=colors, linewidths=0.7, alpha=0.8))
    axes.autoscale_view()
    axes.invert_yaxis()
    axes.set_xlabel("time [s]")
    axes.set_ylabel("m")
    finish(axes, "metres behind the first", ride.times)


def _along(course: Course) -> np.ndarray:
    """Arc lengths along a whole course [m]."""
    return np.linspace(0.0, course.length, int(np.clip(course.length / _PROFILE_STEP, 100, 4000)))
