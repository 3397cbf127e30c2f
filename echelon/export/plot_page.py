"""How pages of plots look and are written: the same every time, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from echelon.export.light import display_encoded
from echelon.export.picture_files import replacing
from echelon.recording import Recording

PAGE = (11.69, 8.27)  # [inch], A4 across
DOTS_PER_INCH = 150
SUFFIXES = (".png", ".pdf", ".svg")
SAMPLE_LIMIT = 1500  # frames that are read, at most: a page shows no more

INK = "#30363d"
FAINT = "#9aa4ad"
STEEL = "#2f6f9f"
RED = "#c0182b"

# A file that is written twice is the same: no dates, no random ids.
_METADATA: Mapping[str, dict[str, Any]] = {
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}


def new_page(recording: Recording) -> Figure:
    """An empty page with the run's title."""
    figure = Figure(figsize=PAGE, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(recording), x=0.012, ha="left", fontsize=12, color=INK)
    return figure


def write_page(figure: Figure, target: Path) -> Path:
    """Write a page to a path that has been checked."""
    # The solver behind the layout leaves noise in the last digits, which would show in the names inside an .svg.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.set_position(tuple(np.round(axes.get_position().bounds, 6).tolist()))
    with replacing(target) as beside:
        suffix = target.suffix.lower()
        with rc_context({"svg.hashsalt": "echelon"}):
            if suffix == ".png":
                _write_png(figure, beside)
            else:
                figure.savefig(beside, format=suffix[1:], metadata=_METADATA[suffix])
    return target


def _write_png(figure: Figure, path: Path) -> None:
    """Write a page with a palette: lines and letters look the same, in a third of the bytes."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(256, dither=Image.Dither.NONE).save(path, format="PNG", optimize=True)


def sampled_frames(recording: Recording) -> np.ndarray:
    """Frames that a page reads, evenly spread, the first and the last included."""
    count = recording.frame_count
    step = max(-(-count // SAMPLE_LIMIT), 1)
    return np.unique(np.append(np.arange(0, count, step), count - 1))


def line_colors(recording: Recording) -> np.ndarray:
    """Colours of all agents for lines on white, so a little darker than they are drawn; shape [agents, 3]."""
    colors = np.full((recording.agent_count, 3), 0.5)
    for cast in recording.casts:
        colors[cast.first_agent : cast.first_agent + cast.agent_count] = cast.colors
    return 0.88 * display_encoded(colors)


def _title(recording: Recording) -> str:
    summary = recording.summary
    seconds = (recording.frame_count - 1) / recording.frame_rate
    parts = [
        str(recording.scenario.get("title") or recording.scenario.get("name", "run")),
        f"{recording.agent_count} agents",
        f"{seconds:.1f} s",
    ]
    parts += [
        f"{summary[key]} {key.replace('_', ' ')}" for key in ("falls", "collisions", "off_road") if key in summary
    ]
    return "   ·   ".join(parts)


def finish(axes: Axes, title: str, times: np.ndarray | None = None) -> None:
    """Title, legend and grid of a panel; with times, its limits along x."""
    axes.set_title(title, loc="left", fontsize=9, color=INK)
    axes.tick_params(labelsize=7, colors=INK)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)
    axes.grid(color=FAINT, alpha=0.25, linewidth=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.1,
            frameon=False,
            fontsize=7,
            ncols=5,
            handlelength=1.4,
            columnspacing=1.0,
        )
    if times is not None and times[-1] > times[0]:
        axes.set_xlim(times[0], times[-1])
