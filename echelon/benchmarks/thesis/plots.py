"""Pictures of the fidelity report: a page a chapter, what the thesis gives beside what we measured.

A panel shows one quantity of one experiment against the number that was varied: directions around a circle, everything
else along an axis. Quantities that were measured under a single condition are left to the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from echelon.benchmarks.thesis.published import EXPERIMENTS, GROUPS, published_rows
from echelon.benchmarks.thesis.rows import AtLeast, FidelityRow, Published
from echelon.export.plot_page import FAINT, INK, RED, STEEL, finish, write_page

BODIES = {"male": STEEL, "female": "#b5495b"}
COLUMNS = 3
PANEL = (3.9, 3.1)  # width and height [in]
DIRECTION = "direction [deg]"
YES_OR_NO = ("ends balanced", "stands")
"""Quantities that are left to the table: they are one, or there is something to mend."""


@dataclass(frozen=True)
class Panel:
    """One quantity of one experiment.

    Attributes:
        title, label: Of the panel, and of its upright axis.
        given: What was varied, with its unit.
        series: For each label the published rows and what we measured, in order.
    """

    title: str
    label: str
    given: str
    series: dict[str, list[tuple[Published, float | None]]]


def write_pages(rows: Sequence[FidelityRow], folder: Path) -> list[Path]:
    """Draw a page for each chapter that was measured, and say where they are.

    Args:
        rows: Of the report.
        folder: Where ``thesis-<group>.png`` go.
    """
    pages: list[Path] = []
    for group in GROUPS:
        panels = [panel for one in EXPERIMENTS if one.group == group for panel in panels_of(one.name, one.title, rows)]
        if panels:
            pages.append(_write_page(panels, folder / f"thesis-{group}.png"))
    return pages


def panels_of(name: str, title: str, rows: Sequence[FidelityRow]) -> list[Panel]:
    """The panels of an experiment: quantities that were measured at three numbers or more."""
    ours = {(row.body, row.condition, row.quantity, row.unit): row.ours for row in rows if row.experiment == name}
    varied: dict[str, set[float]] = {}
    for published in published_rows(name):
        for given, value in published.given.items():
            if not isinstance(value, str):
                varied.setdefault(given, set()).add(value)
    found: dict[tuple[str, str, str], Panel] = {}
    for published in published_rows(name):
        key = (published.body, published.condition, published.quantity, published.unit)
        numbers = [given for given, value in published.given.items() if not isinstance(value, str)]
        if key not in ours or not numbers or published.quantity in YES_OR_NO:
            continue
        given = max(numbers, key=lambda one: len(varied[one]))
        # What takes few values beside it tells one line from another; what goes along with it does not.
        apart = [one for one in numbers if 2 * len(varied[one]) < len(varied[given])]
        label = ", ".join([published.body, *(_short(one, published.given[one]) for one in apart)])
        unit = f" [{published.unit}]" if published.unit != "1" else ""
        panel = found.setdefault((published.quantity, unit, given), Panel(title, published.quantity + unit, given, {}))
        panel.series.setdefault(label, []).append((published, ours[key]))
    return [panel for panel in found.values() if any(len(points) >= 3 for points in panel.series.values())]


def _short(given: str, value: float | str) -> str:
    if isinstance(value, str):
        return value
    name, _, unit = given.removesuffix("]").partition(" [")
    return f"{name} {value:g} {unit}".rstrip()


def _write_page(panels: Sequence[Panel], path: Path) -> Path:
    lines = math.ceil(len(panels) / COLUMNS)
    columns = min(COLUMNS, len(panels))
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * lines), layout="constrained")
    FigureCanvasAgg(figure)
    for place, panel in enumerate(panels):
        round_about = panel.given == DIRECTION
        axes = figure.add_subplot(lines, columns, place + 1, projection="polar" if round_about else None)
        (_around if round_about else _along)(axes, panel)
        axes.set_title(panel.title, fontsize=9, color=INK)
    return write_page(figure, path)


def _color(label: str, place: int) -> str:
    body = label.split(",")[0]
    return BODIES[body] if body in BODIES and place < 2 else ("#c98a1b", "#5c8a4a", RED)[place % 3]


def _along(axes: Axes, panel: Panel) -> None:
    """Ours as a line with dots, the thesis's as crosses, against what was varied."""
    for place, (label, points) in enumerate(panel.series.items()):
        points = sorted(points, key=lambda point: point[0].number(panel.given))
        at = [row.number(panel.given) for row, _ in points]
        color = _color(label, place)
        axes.plot(at, [math.nan if y is None else y for _, y in points], "o-", ms=3, lw=1, color=color, label=label)
        known = [(x, row.thesis) for x, (row, _) in zip(at, points, strict=True) if row.thesis is not None]
        if known:
            axes.plot(*zip(*known, strict=True), "x", ms=6, color=color, label=f"{label}, thesis")
    axes.set_xlabel(panel.given, fontsize=8)
    axes.set_ylabel(panel.label, fontsize=8)
    finish(axes, "")
    axes.legend(fontsize=7, frameon=False)


def _around(axes: Any, panel: Panel) -> None:
    """Around the circle, ahead at the top and left on the left, with what is asked at the least."""
    for place, (label, points) in enumerate(panel.series.items()):
        points = sorted(points, key=lambda point: point[0].number(DIRECTION))
        closed = [*points, points[0]]
        angles = [math.radians(row.number(DIRECTION)) for row, _ in closed]
        color = _color(label, place)
        axes.plot(angles, [0.0 if y is None else y for _, y in closed], "o-", ms=3, lw=1, color=color, label=label)
        least = [
            row.rule.bound if isinstance(row.rule, AtLeast) and row.rule.bound is not None else row.thesis
            for row, _ in closed
        ]
        if all(value is not None for value in least):
            axes.plot(angles, least, ":", lw=1, color=color, label=f"{label}, asked")
    axes.set_theta_zero_location("N")
    ticks = {"ahead": 0.0, "left": 90.0, "behind": 180.0, "right": 270.0}
    axes.set_xticks([math.radians(angle) for angle in ticks.values()], list(ticks), fontsize=7)
    axes.tick_params(labelsize=7)
    axes.grid(color=FAINT, lw=0.4)
    axes.set_ylabel(panel.label, fontsize=8, labelpad=28)
    axes.legend(fontsize=6, frameon=False, loc="lower left", bbox_to_anchor=(-0.3, -0.22))
