"""A page about a search: how the objective fell and success rose, stage by stage, and where the parameters went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from echelon.agents.gymnasts.script import Parameter
from echelon.errors import InputError
from echelon.export.picture_files import checked_path
from echelon.export.plot_page import DOTS_PER_INCH, FAINT, INK, PAGE, RED, STEEL, SUFFIXES, finish, write_page
from echelon.tuning.objective import Objective
from echelon.tuning.stages import Generation

PANELS = 16
"""Parameters that a page has room for; the others go on the last panel."""


def plot_search(
    history: Sequence[Generation],
    objective: Objective,
    parameters: Mapping[str, Parameter],
    path: str | Path,
    title: str = "",
) -> Path:
    """Write a page of plots of a search.

    Args:
        history: Its generations, in order.
        objective: Whose stages they are of.
        parameters: What was tuned, by name, with bounds.
        path: Of the page, .png, .pdf or .svg.
        title: Of the page.

    Raises:
        InputError: A wrong path, or nothing to plot.
    """
    target = checked_path(path, SUFFIXES)
    if not history:
        raise InputError(f"{path}: there is no generation yet, so there is nothing to plot")
    figure = Figure(figsize=PAGE, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.012, ha="left", fontsize=12, color=INK)
    names = list(parameters)
    columns = 4
    rows = -(-min(len(names), PANELS) // columns)
    grid = figure.add_gridspec(2 + rows, columns, height_ratios=(2.4, 1.4, *[1.0] * rows))
    objectives = figure.add_subplot(grid[0, :])
    _draw_objective(objectives, history)
    success = figure.add_subplot(grid[1, :], sharex=objectives)
    _draw_success(success, history, objective)
    for axes in (objectives, success):
        _mark_stages(axes, history, objective, named=axes is objectives)
    success.set_xlabel("generation")
    for place in range(min(len(names), PANELS)):
        shown = [names[place]] if place < PANELS - 1 else names[place:]
        panel = figure.add_subplot(grid[2 + place // columns, place % columns], sharex=objectives)
        _draw_parameters(panel, history, parameters, shown)
    return write_page(figure, target)


def _draw_objective(axes: Axes, history: Sequence[Generation]) -> None:
    places = np.arange(len(history))
    for first, last in _stays(history):
        here = slice(first, last)
        axes.plot(places[here], [one.median for one in history[here]], color=FAINT, linewidth=0.9)
        axes.plot(places[here], [one.best for one in history[here]], color=STEEL, linewidth=1.3)
    axes.plot([], [], color=FAINT, linewidth=0.9, label="middle candidate")
    axes.plot([], [], color=STEEL, linewidth=1.3, label="best candidate")
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_xlim(-0.5, max(len(history) - 0.5, 1.0))
    finish(axes, "objective")


def _draw_success(axes: Axes, history: Sequence[Generation], objective: Objective) -> None:
    places = np.arange(len(history))
    for first, last in _stays(history):
        here = slice(first, last)
        axes.step(places[here], [one.success for one in history[here]], where="mid", color=STEEL, linewidth=1.2)
    axes.axhline(objective.success_rate, color=RED, linewidth=0.9, linestyle=":", label="wanted in the end")
    axes.set_ylim(-0.03, 1.05)
    finish(axes, "copies of the best candidate that succeed")


def _mark_stages(axes: Axes, history: Sequence[Generation], objective: Objective, *, named: bool) -> None:
    for first, last in _stays(history):
        if first:
            again = history[first].stage <= history[first - 1].stage
            axes.axvline(first - 0.5, color=RED if again else INK, linewidth=0.8, linestyle="-" if again else ":")
        # Short stages have no room for their names.
        if named and last - first >= 0.04 * len(history):
            name = objective.stage[history[first].stage].name
            axes.text(first - 0.3, 0.97, f" {name}", transform=axes.get_xaxis_transform(), fontsize=7, va="top")


def _draw_parameters(
    axes: Axes, history: Sequence[Generation], parameters: Mapping[str, Parameter], names: Sequence[str]
) -> None:
    """Where the middle of the search was; several on one panel as shares of their ranges."""
    alone = len(names) == 1
    for place, name in enumerate(names):
        parameter = parameters[name]
        values = np.array([one.middle.get(name, np.nan) for one in history])
        least, width = (0.0, 1.0) if alone else (parameter.least, parameter.most - parameter.least)
        color = STEEL if alone else colormaps["viridis"](place / len(names))
        for first, last in _stays(history):
            axes.plot(np.arange(first, last), (values[first:last] - least) / width, color=color, linewidth=1.0)
    if alone:
        axes.set_ylim(parameters[names[0]].least, parameters[names[0]].most)
    finish(axes, names[0] if alone else f"{len(names)} more, as shares of their ranges")


def _stays(history: Sequence[Generation]) -> list[tuple[int, int]]:
    """First and past-the-last place of each stage of each round."""
    keys = [(one.round, one.stage) for one in history]
    starts = [place for place in range(len(keys)) if place == 0 or keys[place] != keys[place - 1]]
    return list(zip(starts, [*starts[1:], len(keys)], strict=True))
