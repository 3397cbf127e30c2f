"""One page about a course: its plan, its profile, its grades."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from echelon.export.picture_files import checked_path, replacing
from echelon.terrain.course import Course
from echelon.terrain.course_facts import course_facts

PAGE = (10.0, 9.6)  # [inch]
DOTS_PER_INCH = 96
SUFFIXES = (".png", ".pdf", ".svg")

_SAMPLES = 2000  # along the course: a page shows no more
_LAND_CELLS = 160  # of the land, along the longer side of the plan
_INK, _FAINT = "#30363d", "#9aa4ad"
_LAND = LinearSegmentedColormap.from_list("land", ["#e3ebd9", "#eef0e2", "#f4efe3", "#ece1d0"])
_GRADES = LinearSegmentedColormap.from_list(
    "grades", ["#173f7a", "#3f86c6", "#a9cbe4", "#d9d8cc", "#efb04a", "#cf3b2b", "#6b0f2f"]
)
_NORM = Normalize(-13.0, 13.0)  # [%], the same for all, so that courses can be compared

# A file that is written twice is the same: no dates, no random ids.
_METADATA: Mapping[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}


@dataclass(frozen=True)
class _Samples:
    """A course at even steps.

    Attributes:
        s: Along it [km],            shape [n]
        places: [m],                 shape [n, 3]
        grades: [%],                 shape [n]
    """

    s: np.ndarray
    places: np.ndarray
    grades: np.ndarray


def plot_course(course: Course, path: str | Path) -> Path:
    """Draw a course on a page: plan with its land, side streets and kilometres, profile, grades.

    Args:
        course: What to draw.
        path: Of the page, .png, .pdf or .svg.

    Raises:
        InputError: A wrong path.
    """
    target = checked_path(path, SUFFIXES)
    samples = _sampled(course)
    figure = Figure(figsize=PAGE, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    title, facts = _title(course)
    figure.suptitle(f"{title}\n{facts}", x=0.012, ha="left", fontsize=10, color=_INK, linespacing=1.5)
    grid = figure.add_gridspec(3, 1, height_ratios=(3.9, 1.15, 0.95))
    plan = figure.add_subplot(grid[0])
    _draw_plan(plan, course, samples)
    profile = figure.add_subplot(grid[1])
    _draw_profile(profile, samples)
    _draw_grades(figure.add_subplot(grid[2], sharex=profile), samples)
    profile.tick_params(labelbottom=False)
    with replacing(target) as beside:
        suffix = target.suffix.lower()
        with rc_context({"svg.hashsalt": "echelon"}):
            figure.savefig(beside, format=suffix[1:], metadata=_METADATA[suffix])
    return target


def _sampled(course: Course) -> _Samples:
    line = course.centreline
    s = np.linspace(0.0, line.length, _SAMPLES + 1)
    if course.closed:
        s[-1] = np.nextafter(line.length, 0.0)  # the end of the lap, not its start again
    grades = 100.0 * line.grade(s)
    return _Samples(s / 1000.0, line.position(s), grades)


def _title(course: Course) -> tuple[str, str]:
    """What it is called, and what there is to know about it."""
    facts = course_facts(course)
    way = "" if facts.counter_clockwise is None else "counter-" * facts.counter_clockwise + "clockwise "
    parts = [
        f"{facts.length / 1000:.2f} km {way}{'circuit' if course.closed else 'from start to finish'}",
        f"{facts.climb:.0f} m of climbing",
        f"grades {100 * facts.steepest_down:+.1f} % to {100 * facts.steepest_up:+.1f} %",
        f"{len(facts.corners)} corners, sharpest radius {facts.sharpest:.0f} m",
    ]
    return course.title or course.name, "   ·   ".join(parts)


# ---- panels --------------------------------------------------------------------------------------------------------
def _draw_plan(axes: Axes, course: Course, samples: _Samples) -> None:
    flat = samples.places[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    # A page across: what the box leaves free beside the course is land.
    room = 0.06 * float((high - low).max()) + 60.0
    low, high = low - room, high + room
    wide = 1.78 * (high[1] - low[1]) - (high[0] - low[0])
    if wide > 0.0:
        low[0], high[0] = low[0] - 0.5 * wide, high[0] + 0.5 * wide
    _draw_land(axes, course, low, high)
    scale = float((high - low).max())
    for street in course.side_streets:
        x, y = np.array(street).T
        axes.plot(x, y, color="white", linewidth=2.0, solid_capstyle="butt")
        axes.plot(x, y, color=_FAINT, linewidth=0.9, solid_capstyle="butt")
    pieces = np.stack([flat[:-1], flat[1:]], axis=1)
    axes.plot(*flat.T, color="white", linewidth=5.5, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(*flat.T, color=_INK, linewidth=4.1, solid_capstyle="round", solid_joinstyle="round")
    road = LineCollection(list(pieces), array=samples.grades[:-1], cmap=_GRADES, norm=_NORM, linewidths=3.1)
    road.set_capstyle("round")
    axes.add_collection(road)
    _draw_kilometres(axes, course, scale)
    _draw_ways(axes, course, scale)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    bar = axes.figure.colorbar(road, ax=axes, pad=0.01, fraction=0.022, aspect=38)
    bar.set_label("grade [%]", fontsize=8, color=_INK)
    bar.ax.tick_params(labelsize=7, colors=_INK)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    _finish(axes, "plan")


def _draw_land(axes: Axes, course: Course, low: np.ndarray, high: np.ndarray) -> None:
    cell = float((high - low).max()) / _LAND_CELLS
    x, y = (np.arange(low[axis], high[axis] + cell, cell) for axis in (0, 1))
    heights = course.land_height(np.stack(np.meshgrid(x, y), axis=-1))
    interval = _interval(float(np.ptp(heights)))
    levels = np.arange(np.floor(heights.min() / interval), np.ceil(heights.max() / interval) + 1.0) * interval
    axes.contourf(x, y, heights, levels, cmap=_LAND)
    axes.contour(x, y, heights, levels, colors="#b9ae97", linewidths=0.4, alpha=0.7)
    axes.text(
        0.995, 0.01, f"contours every {interval:g} m", transform=axes.transAxes, ha="right", fontsize=7, color="#8a7f68"
    )


def _interval(spread: float) -> float:
    """A round height between contours, so that there are about ten [m]."""
    least = max(spread, 1.0) / 10.0
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(power * step for step in (1.0, 2.0, 5.0, 10.0) if power * step >= least))


def _draw_kilometres(axes: Axes, course: Course, scale: float) -> None:
    every = max(1.0, round(course.length / 14_000.0)) if course.length > 2500.0 else 0.5
    marks = np.arange(every * 1000.0, course.length - 0.3 * every * 1000.0, every * 1000.0)
    if not len(marks):
        return
    places, left = course.centreline.position(marks)[:, :2], course.centreline.left(marks)
    axes.plot(*places.T, "o", markersize=4.0, color="white", markeredgecolor=_INK, markeredgewidth=0.8)
    for mark, (x, y) in zip(marks, (places + 0.021 * scale * left).tolist(), strict=True):
        axes.text(x, y, f"{mark / 1000:g}", fontsize=8, ha="center", va="center", color=_INK)


def _draw_ways(axes: Axes, course: Course, scale: float) -> None:
    """Where it starts and which way it goes."""
    line = course.centreline
    # Beside the road, on the outside where there is one.
    side = 1.0 if course_facts(course).counter_clockwise is False else -1.0
    start, along, away = line.position(0.0)[:2], line.tangent(0.0)[:2], side * line.left(0.0)
    axes.plot(*(start + np.outer([-0.014, 0.014], away) * scale).T, color=_INK, linewidth=2.4)
    (x, y), (tip_x, tip_y) = (start + scale * (0.024 * away + part * along) for part in (0.0, 0.055))
    arrow = {"arrowstyle": "-|>", "color": _INK, "linewidth": 1.3}
    axes.annotate("", (tip_x, tip_y), (x, y), arrowprops=arrow)
    x, y = (start + 0.037 * scale * away).tolist()
    horizontal = "left" if away[0] > 0.4 else "right" if away[0] < -0.4 else "center"
    label = "start and finish" if course.closed else "start"
    axes.text(x, y, label, fontsize=8, color=_INK, ha=horizontal, va="center")
    if not course.closed:
        finish, away = line.position(line.length)[:2], side * line.left(line.length)
        axes.plot(*(finish + np.outer([-0.014, 0.014], away) * scale).T, color=_INK, linewidth=2.4)
        x, y = (finish + 0.03 * scale * away).tolist()
        axes.text(x, y, "finish", fontsize=8, color=_INK, ha="center", va="center")


def _draw_profile(axes: Axes, samples: _Samples) -> None:
    heights = samples.places[:, 2]
    spread = max(float(np.ptp(heights)), 5.0)
    floor = float(heights.min()) - 0.25 * spread
    under = axes.fill_between(samples.s, heights, floor, color="none")
    extent = (0.0, float(samples.s[-1]), floor, float(heights.max()))
    image = axes.imshow(samples.grades[None], cmap=_GRADES, norm=_NORM, aspect="auto", extent=extent)
    image.set_clip_path(under.get_paths()[0], transform=axes.transData)
    axes.plot(samples.s, heights, color=_INK, linewidth=1.1)
    axes.set_xlim(0.0, samples.s[-1])
    axes.set_ylim(floor, float(heights.max()) + 0.12 * spread)
    axes.set_ylabel("height [m]")
    _finish(axes, "profile")


def _draw_grades(axes: Axes, samples: _Samples) -> None:
    axes.axhline(0.0, color=_FAINT, linewidth=0.8)
    for sign in (1.0, -1.0):
        part = np.maximum(sign * samples.grades, 0.0) * sign
        axes.fill_between(samples.s, part, 0.0, color=_GRADES(_NORM(sign * 6.0)), alpha=0.45, linewidth=0.0)
    axes.plot(samples.s, samples.grades, color=_INK, linewidth=0.8)
    spread = max(float(np.ptp(samples.grades)), 2.0)
    axes.set_ylim(float(samples.grades.min()) - 0.2 * spread, float(samples.grades.max()) + 0.25 * spread)
    for at, above in ((int(samples.grades.argmax()), True), (int(samples.grades.argmin()), False)):
        side = "left" if samples.s[at] < 0.5 * samples.s[-1] else "right"
        axes.annotate(
            f"{samples.grades[at]:+.1f} %",
            (float(samples.s[at]), float(samples.grades[at])),
            xytext=(5 if side == "left" else -5, 3 if above else -9),
            textcoords="offset points",
            fontsize=7.5,
            ha=side,
            color=_INK,
        )
        axes.plot(samples.s[at], samples.grades[at], "o", markersize=3, color=_INK)
    axes.set_ylabel("grade [%]")
    axes.set_xlabel("along the course [km]")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    _finish(axes, "grades")


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=9, color=_INK)
    axes.tick_params(labelsize=7, colors=_INK)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)
    axes.grid(color=_FAINT, alpha=0.25, linewidth=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
