"""One page about a run: where everybody went, how fast, in which phase of their hop, how near to one another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from scipy.spatial import KDTree

from echelon.errors import InputError
from echelon.export.picture_files import checked_path
from echelon.export.plot_page import (
    FAINT,
    INK,
    RED,
    STEEL,
    SUFFIXES,
    finish,
    line_colors,
    new_page,
    sampled_frames,
    write_page,
)
from echelon.export.ride_plots import ride_page
from echelon.export.road_scene import is_road
from echelon.recording import Recording

RASTER_SECONDS = 20.0  # [s] of touchdowns that are shown: single hops must be told apart
_RASTER_POINTS = 180.0  # height of that panel, about [point]

_FENCE = "#8a5a33"
_BODY_RADIUS = 0.35  # [m] where the scenario does not say


@dataclass(frozen=True)
class _Samples:
    """What is read of a recording, at some of its frames.

    Attributes:
        times: [s],                                  [samples]
        places: Of the agents [m],                   [samples, agents, 2]
        actors: Places of the actors [m],            [samples, actors, 2]
        speeds: Along the ground [m/s],              [samples, agents]
        desired: Desired speeds [m/s],               [samples, agents]
        in_corral: How many are in,                  [samples]
    """

    times: np.ndarray
    places: np.ndarray
    actors: np.ndarray
    speeds: np.ndarray
    desired: np.ndarray
    in_corral: np.ndarray


def plot_run(recording: Recording, path: str | Path) -> Path:
    """Write a page of plots.

    Of a herd: paths from above, speeds, touchdowns, distances between neighbours, how many are penned. Of a ride: the
    course from above, and along its profile speeds, powers, gaps, offsets and lean.

    Args:
        recording: What happened.
        path: Of the page, .png, .pdf or .svg.

    Raises:
        InputError: A wrong path, or a recording without frames.
    """
    target = checked_path(path, SUFFIXES)
    if recording.frame_count < 1:
        raise InputError(f"{recording.path}: has no frames yet, so there is nothing to plot")
    if is_road(recording.world):
        return write_page(ride_page(recording), target)
    samples = _read(recording)
    colors = line_colors(recording)
    figure = new_page(recording)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1.0), height_ratios=(1.5, 1.0))
    upper_right = grid[0, 1].subgridspec(2, 1)
    _draw_paths(figure.add_subplot(grid[0, 0]), recording, samples, colors)
    _draw_touchdowns(figure.add_subplot(grid[1, 0]), recording, colors)
    _draw_speeds(figure.add_subplot(upper_right[0]), samples)
    _draw_distances(figure.add_subplot(upper_right[1]), recording, samples)
    last = figure.add_subplot(grid[1, 1])
    if recording.world.get("corral") is not None:
        _draw_penned(last, recording, samples)
    else:
        _draw_spread(last, samples)
    return write_page(figure, target)


# ---- what is read --------------------------------------------------------------------------------------------------
def _read(recording: Recording) -> _Samples:
    frames = sampled_frames(recording)
    return _Samples(
        times=frames / recording.frame_rate,
        places=np.asarray(recording.link_poses[frames, :, 0, :2], dtype=np.float64),
        actors=np.asarray(recording.actor_poses[frames, :, :2], dtype=np.float64),
        speeds=np.linalg.norm(np.asarray(recording.velocities[frames, :, :2]), axis=2),
        desired=np.linalg.norm(np.asarray(recording.desired_velocities[frames]), axis=2),
        in_corral=np.asarray(recording.in_corral[frames]),
    )


# ---- panels --------------------------------------------------------------------------------------------------------
def _draw_paths(axes: Axes, recording: Recording, samples: _Samples, colors: np.ndarray) -> None:
    for wall in recording.world.get("walls", ()):
        points = np.asarray(wall["points"], dtype=float)
        points = np.vstack([points, points[:1]]) if wall["closed"] else points
        axes.plot(points[:, 0], points[:, 1], color=_FENCE, linewidth=1.6, solid_capstyle="round")
    for column in recording.world.get("columns", ()):
        axes.add_patch(Circle(tuple(column["center"]), column["radius"], color=_FENCE))
    paths = samples.places.transpose(1, 0, 2)
    axes.add_collection(LineCollection(list(paths), colors=colors, linewidths=0.9, alpha=0.75))
    rings = [(float(red), float(green), float(blue)) for red, green, blue in colors]
    axes.scatter(*samples.places[0].T, s=10, facecolors="white", edgecolors=rings, linewidths=0.9, zorder=3)
    axes.scatter(*samples.places[-1].T, s=22, c=colors, edgecolors=INK, linewidths=0.5, zorder=4)
    for index, actor in enumerate(recording.actors):
        x, y = samples.actors[:, index].T
        axes.plot(x, y, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), label=actor.name)
        axes.plot(x[-1:], y[-1:], marker="D", markersize=5, color=INK)
    axes.plot([], [], "o", markersize=3.5, markerfacecolor="white", markeredgecolor=INK, label="start")
    axes.plot([], [], "o", markersize=5, color=FAINT, markeredgecolor=INK, markeredgewidth=0.5, label="end")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    finish(axes, "paths from above")


def _draw_speeds(axes: Axes, samples: _Samples) -> None:
    _draw_band(axes, samples.times, samples.speeds)
    axes.plot(samples.times, samples.desired.mean(axis=1), color="#c2571a", linewidth=1.0, label="desired, mean")
    axes.set_ylabel("m/s")
    axes.set_ylim(0.0, 1.08 * float(max(samples.speeds.max(), samples.desired.mean(axis=1).max(), 0.1)))
    finish(axes, "speed", samples.times)


def _draw_touchdowns(axes: Axes, recording: Recording, colors: np.ndarray) -> None:
    """A mark for each touchdown, a row for each agent: who hops in step with whom."""
    shown = min((recording.frame_count - 1) / recording.frame_rate, RASTER_SECONDS)
    events = recording.events[recording.events["frame"] <= shown * recording.frame_rate]
    names = tuple(recording.event_names)
    down = events[events["kind"] == names.index("touchdown")]
    height = float(np.clip(0.8 * _RASTER_POINTS / recording.agent_count, 0.8, 8.0))
    axes.scatter(
        down["frame"] / recording.frame_rate,
        down["agent"],
        s=height**2,
        c=colors[down["agent"]],
        marker="|",
        linewidths=1.2,
    )
    fallen = events[events["kind"] == names.index("fall")]
    if len(fallen):
        axes.plot(fallen["frame"] / recording.frame_rate, fallen["agent"], "x", color=RED, markersize=5, label="fall")
    axes.set_ylabel("agent")
    axes.set_xlabel("time [s]")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(-0.8, recording.agent_count - 0.2)
    finish(axes, "touchdowns" if shown < RASTER_SECONDS else f"touchdowns, first {shown:g} s", np.array([0.0, shown]))


def _draw_distances(axes: Axes, recording: Recording, samples: _Samples) -> None:
    if samples.places.shape[1] > 1:
        nearest = np.stack([KDTree(places).query(places, k=2)[0][:, 1] for places in samples.places])
        _draw_band(axes, samples.times, nearest)
    radius = recording.scenario.get("herd", {}).get("radius", _BODY_RADIUS)
    axes.axhline(2.0 * radius, color=RED, linewidth=0.9, linestyle=":", label="touching")
    axes.set_ylabel("m")
    axes.set_ylim(bottom=0.0)
    finish(axes, "nearest neighbour", samples.times)


def _draw_penned(axes: Axes, recording: Recording, samples: _Samples) -> None:
    axes.fill_between(samples.times, samples.in_corral, step="mid", color=STEEL, alpha=0.25, linewidth=0.0)
    axes.step(samples.times, samples.in_corral, where="mid", color=STEEL, linewidth=1.2)
    axes.set_ylabel("agents")
    axes.set_xlabel("time [s]")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0.0, recording.agent_count * 1.05)
    finish(axes, "in the corral", samples.times)


def _draw_spread(axes: Axes, samples: _Samples) -> None:
    middle = samples.places.mean(axis=1, keepdims=True)
    _draw_band(axes, samples.times, np.linalg.norm(samples.places - middle, axis=2))
    axes.set_ylabel("m")
    axes.set_xlabel("time [s]")
    axes.set_ylim(bottom=0.0)
    finish(axes, "distance to the middle of the herd", samples.times)


def _draw_band(axes: Axes, times: np.ndarray, values: np.ndarray) -> None:
    """Range, middle half and median over agents of values [samples, agents]."""
    low, lower, middle, upper, high = np.percentile(values, (0, 25, 50, 75, 100), axis=1)
    axes.fill_between(times, low, high, color=STEEL, alpha=0.15, linewidth=0.0, label="range")
    axes.fill_between(times, lower, upper, color=STEEL, alpha=0.35, linewidth=0.0, label="middle half")
    axes.plot(times, middle, color=STEEL, linewidth=1.2, label="median")
