"""Pictures of the group tests: what was lost by which law, and the ways that agents took, seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch

from echelon.benchmarks.group_problems import ORCA, PAPER, PROBLEMS
from echelon.benchmarks.group_run import Track
from echelon.export.plot_page import DOTS_PER_INCH, FAINT, INK, RED, STEEL, finish, write_page

Row = dict[str, Any]

OURS = "echelon"
COLORS = {PAPER: FAINT, OURS: STEEL, ORCA: "#c98a1b"}
MEASURES = (
    ("lost_percent", "agents lost [%]"),
    ("collisions_per_100", "collisions for 100 agents"),
    ("dispersion", "spread, end over start"),
)
DOT_EVERY = 2.0  # [s] between the dots on a way


def write_summary(rows: Sequence[Row], path: Path) -> Path:
    """Draw what `run_groups_benchmark` returned: a column for each problem, a row for each measure.

    Args:
        rows: The benchmark's.
        path: Of the picture: .png, .pdf or .svg.
    """
    figure = _figure((11.69, 6.6), "Group tests: falls and collisions by law")
    axes = figure.subplots(len(MEASURES), len(PROBLEMS), sharex=True, sharey="row")
    groups = list(dict.fromkeys((row["character"], row["agents"]) for row in rows))
    for column, problem in enumerate(PROBLEMS):
        for line, (key, label) in enumerate(MEASURES):
            panel = axes[line, column]
            _bars(panel, [row for row in rows if row["problem"] == problem], groups, key)
            finish(panel, problem if line == 0 else "")
            panel.set_axisbelow(True)
            if column == 0:
                panel.set_ylabel(label)
        # A thousand collisions, and one, on the same panel.
        axes[1, column].set_yscale("symlog", linthresh=1.0)
    axes[1, 0].set_ylim(0.0, 2000.0)
    axes[1, 0].set_yticks([0, 1, 10, 100, 1000], ["0", "1", "10", "100", "1000"])
    shown = [Patch(color=color, label=law) for law, color in COLORS.items()]
    figure.legend(handles=shown, loc="outside upper right", frameon=False, fontsize=8, ncols=3)
    return write_page(figure, path)


def _bars(panel: Axes, rows: Sequence[Row], groups: Sequence[tuple[str, int]], key: str) -> None:
    for place, law in enumerate((PAPER, OURS, ORCA)):
        chosen = {(row["character"], row["agents"]): row for row in rows if _kind(row["law"]) == law}
        values = [_value(chosen.get(group), key) for group in groups]
        panel.bar(np.arange(len(groups)) + 0.27 * (place - 1), values, 0.25, color=COLORS[law])
    panel.set_xticks(range(len(groups)), [f"{count} {name}" for name, count in groups], rotation=35, ha="right")


def _kind(law: str) -> str:
    return law if law in (PAPER, ORCA) else OURS


def _value(row: Row | None, key: str) -> float:
    if row is None:
        return float("nan")
    if key == "collisions_per_100":
        return 100.0 * row["collisions"] / (row["agents"] * row["seeds"])
    return float("nan") if row[key] is None else float(row[key])


def write_paths(tracks: Sequence[tuple[str, Track]], path: Path, columns: int = 3) -> Path:
    """Draw runs from above, each in a panel of its own.

    Args:
        tracks: Title and run of each panel, row by row.
        path: Of the picture: .png, .pdf or .svg.
        columns: Panels in a row.
    """
    rows = -(-len(tracks) // columns)
    figure = _figure((11.69, 1.2 + 1.75 * rows), "Ways taken, from left to right; red: fell; dots every two seconds")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for panel, (title, track) in zip(axes, tracks, strict=False):
        draw_paths(panel, track)
        finish(panel, title)
    for panel in axes[len(tracks) :]:
        panel.set_visible(False)
    return write_page(figure, path)


def draw_paths(panel: Axes, track: Track) -> None:
    """Everybody's way, fences and columns [m]."""
    places, world = track.positions, track.scenario.world
    down = track.fallen.any(axis=0)
    step = max(track.scenario.frame_rate // 3, 1)
    ways = places[::step].transpose(1, 0, 2)
    panel.add_collection(LineCollection(list(ways[~down]), colors=STEEL, linewidths=0.4, alpha=0.7))
    panel.add_collection(LineCollection(list(ways[down]), colors=RED, linewidths=0.8))
    dots = places[:: round(DOT_EVERY * track.scenario.frame_rate)].reshape(-1, 2)
    panel.plot(*dots.T, ".", color=INK, markersize=0.7)
    panel.plot(*places[-1, down].T, "x", color=RED, markersize=3)
    low, high = places.min(axis=(0, 1)) - 2.0, places.max(axis=(0, 1)) + 2.0
    for x, y, radius in world.all_columns():
        panel.add_patch(Circle((x, y), radius, color=INK))
    panel.add_collection(LineCollection(list(world.inner_fences()), colors=INK, linewidths=1.5))
    panel.set_aspect("equal", adjustable="box")
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])


def _figure(size: tuple[float, float], title: str) -> Figure:
    figure = Figure(figsize=size, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.012, ha="left", fontsize=12, color=INK)
    return figure
