"""What `echelon bench scaling` found, for people: tables on the terminal, CSV files, plots, a page of documentation.

    python -m echelon.benchmarks.scaling_report docs/benchmarks MACHINE

measures this machine into ``docs/benchmarks/MACHINE/scaling.csv`` (other engines into ``scaling-peers.csv``), plots it
into ``scaling.png`` there, and writes ``docs/benchmarks/scaling.md`` anew from the files of all machines; without
MACHINE it only does the latter.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from echelon.benchmarks.csv_rows import read_csv, write_csv
from echelon.benchmarks.scaling import run_scaling_benchmark
from echelon.errors import InputError

Row = dict[str, Any]

OURS = "Echelon"
TABLE, PEERS, PLOT, PAGE_NAME = "scaling.csv", "scaling-peers.csv", "scaling.png", "scaling.md"

PLOT_SIZE = (8.0, 5.6)  # [inch]
PLOT_DOTS = 110  # an inch
INK, FAINT = "#30363d", "#9aa4ad"
KIND_COLORS = {"hoppers": "#2f6f9f", "riders": "#c0182b"}
PHASE_COLORS = {"see": "#2f6f9f", "want": "#4f9d8a", "act": "#c0182b", "exchange": "#7a5ea8", "record": "#d08a1d"}


def _number(key: str, digits: int, scale: float = 1.0) -> Callable[[Row], str]:
    """A column of numbers; a dash where there is none."""

    def text(row: Row) -> str:
        value = row.get(key)
        return "–" if value is None else f"{scale * value:,.{digits}f}"

    return text


def _figures(key: str) -> Callable[[Row], str]:
    """A column of numbers of any size, three digits each, small ones to a thousandth."""

    def text(row: Row) -> str:
        value = row.get(key)
        if value is None:
            return "–"
        return f"{value:,.0f}" if value >= 100 else f"{value:.3g}" if value >= 0.1 else f"{value:.3f}"

    return text


def _words(key: str) -> Callable[[Row], str]:
    return lambda row: "–" if row.get(key) is None else str(row[key])


Column = tuple[str, Callable[[Row], str]]

COLUMNS: tuple[Column, ...] = (
    ("agents", _number("agents", 0)),
    ("threads", _words("threads")),
    ("frame [ms]", _figures("frame_ms")),
    ("see [ms]", _figures("see_ms")),
    ("want [ms]", _figures("want_ms")),
    ("act [ms]", _figures("act_ms")),
    ("record [ms]", _figures("record_ms")),
    ("write [ms]", _figures("write_ms")),
    ("not kept [ms]", _figures("unrecorded_ms")),
    ("agent [µs]", _figures("agent_us")),
    ("real time", _figures("real_time_factor")),
    ("speed -up", _number("speedup", 2)),
    ("MB", _number("peak_memory_mb", 0)),
)
PEER_COLUMNS: tuple[Column, ...] = (
    ("engine", _words("engine")),
    ("threads", _words("threads")),
    ("step [ms]", _number("step_seconds", 3, 1e3)),
    ("integrator", _words("integrator")),
    ("precision", _words("precision")),
    ("contact sites", _words("contacts")),
    ("an agent's step [µs]", _figures("substep_us")),
    ("s per s", _figures("agent_seconds_per_second")),
)
WORDS = ("engine", "integrator", "precision")
"""Headings of columns that hold words, not numbers."""


def ours(rows: Sequence[Row]) -> list[Row]:
    """Rows of crowds."""
    return [row for row in rows if row["engine"] == OURS]


def compared(rows: Sequence[Row]) -> list[Row]:
    """Rows of the other engines, and those of our crowd of hoppers that comes nearest to theirs in size."""
    others = [row for row in rows if row["engine"] != OURS]
    if not others:
        return []
    sizes = [row["agents"] for row in ours(rows) if row["kind"] == "hoppers"]
    nearest = min(sizes, key=lambda size: abs(size - others[0]["agents"]), default=None)
    found = [row for row in ours(rows) if row["kind"] == "hoppers" and row["agents"] == nearest]
    return [_as_a_peer(row) for row in found] + others


def _as_a_peer(row: Row) -> Row:
    rate = row.get("substep_us")
    return row | {"agent_seconds_per_second": None if rate is None else row["step_seconds"] / rate * 1e6}


def threads_text(asked: int) -> str:
    """Threads that were asked for, in words."""
    return f"{asked} thread{'s' if asked > 1 else ''}" if asked else "as many threads as are worth it"


def growth(rows: Sequence[Row]) -> list[str]:
    """A line for each kind and number of threads: what an agent costs in the largest crowd, against a thousand."""
    lines = []
    for kind, threads in dict.fromkeys((row["kind"], row["asked_threads"]) for row in ours(rows)):
        costs = {
            row["agents"]: row["agent_us"]
            for row in ours(rows)
            if (row["kind"], row["asked_threads"]) == (kind, threads) and row["agent_us"] is not None
        }
        largest = max(costs, default=0)
        if 1000 in costs and largest > 1000:
            lines.append(
                f"{kind}, {threads_text(threads)}: one of {largest:,} costs "
                f"{costs[largest] / costs[1000]:.2f} times what one of 1,000 does."
            )
    return lines


def conditions(rows: Sequence[Row]) -> list[str]:
    """A line for each kind of crowd: step, substeps, contacts, lanes and precision of its rates."""
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in ours(rows)):
        row = next(row for row in ours(rows) if row["kind"] == kind)
        lines.append(
            f"{kind}: {row['substeps']} substeps of {1e3 * row['step_seconds']:.3f} ms a frame "
            f"({row['integrator']}, control every {1e3 * row['tick_seconds']:.1f} ms), "
            f"{row['contacts']} contact sites, {row['precision']} in {row['lanes']} lanes."
        )
    return lines


def remarks(rows: Sequence[Row]) -> list[str]:
    """A line for every rate that is not given."""
    return [
        f"{row['engine']}, {row['agents']:,} {row['kind']}: no rate, since {row['why']}."
        for row in rows
        if not row["sane"]
    ]


def what_was_measured(rows: Sequence[Row]) -> str:
    """One line: on which machine, with which versions."""
    return f"{rows[0]['machine']}; {rows[0]['versions']}." if rows else "Nothing was measured."


def sections(rows: Sequence[Row]) -> list[tuple[str, tuple[Column, ...], list[Row]]]:
    """The tables: title, columns, rows."""
    found: list[tuple[str, tuple[Column, ...], list[Row]]] = []
    for kind in dict.fromkeys(row["kind"] for row in ours(rows)):
        found.append((f"A frame of a crowd of {kind}", COLUMNS, [row for row in ours(rows) if row["kind"] == kind]))
    others = compared(rows)
    if others:
        found.append((f"One hopper's step, {others[-1]['agents']:,} at once", PEER_COLUMNS, others))
    return found


def print_table(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print what `run_scaling_benchmark` returned."""
    console = console or Console()
    for title, columns, chosen in sections(rows):
        if not chosen:
            continue
        table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False, title_justify="left")
        for heading, text in columns:
            # As narrow as can be, for narrow terminals: headings wrap, numbers below them do not.
            cells = [text(row) for row in chosen]
            cells = [word for cell in cells for word in cell.split()] if heading in WORDS else cells
            width = max(map(len, [*heading.split(), *cells]))
            table.add_column(Text(heading), justify="left" if heading in WORDS else "right", width=width)
        for row in chosen:
            table.add_row(*(Text(text(row)) for _, text in columns))
        console.print(table)
    for line in (what_was_measured(rows), *conditions(rows), *growth(rows), *remarks(rows)):
        console.print(line, markup=False, highlight=False)


# ---- files -----------------------------------------------------------------------------------------------------------
def write_files(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write the tables and, of crowds, the plot into a folder, which is made; returns their paths.

    Raises:
        InputError: The folder cannot be written.
    """
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, chosen in ((TABLE, ours(rows)), (PEERS, [row for row in rows if row["engine"] != OURS])):
            if chosen:
                keys = dict.fromkeys(key for row in chosen for key in row)
                write_csv([{key: row.get(key) for key in keys} for row in chosen], folder / name)
                written.append(folder / name)
        if any(row["agent_us"] is not None for row in ours(rows)):
            _replace(folder / PLOT, plot(ours(rows)))
            written.append(folder / PLOT)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    return written


def plot(rows: Sequence[Row]) -> bytes:
    """Cost of an agent and times real time over the size of the crowd, as a PNG with a small palette."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=PLOT_SIZE, dpi=PLOT_DOTS, layout="constrained")
    FigureCanvasAgg(figure)
    cost, speed, hoppers, riders = figure.subplots(2, 2).ravel()
    first = rows[0]["asked_threads"]
    for kind, threads in dict.fromkeys((row["kind"], row["asked_threads"]) for row in rows):
        chosen = [row for row in rows if (row["kind"], row["asked_threads"]) == (kind, threads) and row["agent_us"]]
        sizes = [row["agents"] for row in chosen]
        style = {"color": KIND_COLORS[kind], "marker": "o", "markersize": 3.5, "linewidth": 1.4}
        style |= {"linestyle": "-" if threads == first else "--"}
        label = f"{kind}, {threads_text(threads)}"
        cost.plot(sizes, [row["agent_us"] for row in chosen], label=label, **style)
        speed.plot(sizes, [row["real_time_factor"] for row in chosen], label=label, **style)
    speed.axhline(1.0, color=FAINT, linewidth=0.8)
    for axes, title in ((cost, "an agent's frame [µs]"), (speed, "times real time")):
        axes.set(xscale="log", yscale="log", xlabel="agents")
        axes.set_title(title, fontsize=9, loc="left", color=INK)
    cost.legend(fontsize=7, frameon=False)
    _plot_phases(hoppers, rows, "hoppers")
    _plot_phases(riders, rows, "riders")
    for axes in (cost, speed, hoppers, riders):
        axes.tick_params(which="both", labelsize=7, colors=INK)
        axes.xaxis.label.set_size(8)
        axes.spines[["top", "right"]].set_visible(False)
    file = io.BytesIO()
    figure.savefig(file, format="png")
    picture = Image.open(file).convert("RGB")
    file = io.BytesIO()
    picture.quantize(64, dither=Image.Dither.NONE).save(file, format="PNG", optimize=True)
    return file.getvalue()


def _plot_phases(axes: Any, rows: Sequence[Row], kind: str) -> None:
    """Bars: which part of a frame each phase takes, with the first number of threads."""
    first = rows[0]["asked_threads"]
    chosen = [row for row in rows if row["kind"] == kind and row["asked_threads"] == first and row["agent_us"]]
    axes.set_title(f"parts of a frame, {kind}", fontsize=9, loc="left", color=INK)
    if not chosen:
        axes.set_axis_off()
        return
    bottom = [0.0] * len(chosen)
    for phase, color in PHASE_COLORS.items():
        parts = [100.0 * row[f"{phase}_ms"] / row["frame_ms"] for row in chosen]
        if max(parts) > 0.5:
            axes.bar(range(len(chosen)), parts, bottom=bottom, color=color, width=0.7, label=phase)
        bottom = [below + part for below, part in zip(bottom, parts, strict=True)]
    axes.set_xticks(range(len(chosen)), [f"{row['agents']:,}" for row in chosen])
    axes.set(ylim=(0, 100), xlabel="agents")
    axes.set_ylabel("%", fontsize=8)
    axes.legend(fontsize=7, loc="lower left")


def _replace(path: Path, data: bytes) -> None:
    beside = path.with_name(f".{path.name}.new")
    beside.write_bytes(data)
    os.replace(beside, path)


# ---- the documentation's page ----------------------------------------------------------------------------------------
def page(folder: Path) -> str:
    """The page, in Markdown, from every machine's files in a folder."""
    parts = [PAGE]
    for path in sorted(folder.glob(f"*/{TABLE}")):
        peers = path.with_name(PEERS)
        rows = read_csv(path) + (read_csv(peers) if peers.exists() else [])
        parts.append(f"## {path.parent.name}\n\n{what_was_measured(rows)}\n")
        if path.with_name(PLOT).exists():
            parts.append(
                f"![Cost of an agent, speed and phases over the size of the crowd]({path.parent.name}/{PLOT})\n"
            )
        for title, columns, chosen in sections(rows):
            parts.append(f"{title}:\n\n" + _markdown(columns, chosen))
        parts.append("\n".join(f"* {line}" for line in (*conditions(rows), *growth(rows))) + "\n")
        others = [f"* {row['engine']}: {row['why']}; {row['versions']}." for row in rows if row["engine"] != OURS]
        if others:
            parts.append("\n".join(dict.fromkeys(others)) + "\n")
        parts += [f"* {line}\n" for line in remarks(ours(rows))]
    return "\n".join(parts)


def _markdown(columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> str:
    lines = [" | ".join(heading for heading, _ in columns)]
    lines.append(" | ".join("---" if heading in WORDS else "---:" for heading, _ in columns))
    lines += [" | ".join(text(dict(row)) for _, text in columns) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def write_page(folder: Path) -> Path:
    """Write ``scaling.md`` in a folder from the machines' files there; returns its path."""
    path = folder / PAGE_NAME
    _replace(path, page(folder).encode())
    return path


PAGE = """\
# From sixteen to a hundred thousand

`echelon bench scaling` measures what a frame costs, phase by phase, as a crowd grows: hoppers in a herd on open ground,
2.5 m apart at the start, and riders in a peloton on a straight road that goes up and down, wider and then longer for
more of them. Everything is as in `echelon simulate`: neighbours from the hash grid, rules, control, contact with the
ground and with one another, dynamics, and the recording on disk.

* **see**: who is near: the hash grid and the nearest neighbours of each, and, of a herd, who collides.
* **want**: what everybody decides on; of riders also who strays off the road or touches another.
* **act**: control, contact, dynamics, integration: the substeps of everybody's body.
* **record**: noting what happened, and handing chunks of it over, waiting for the disk included.
* **write**: a thread of its own that writes a chunk while the next is simulated; no part of a frame's time unless the
  disk cannot keep up, when record waits for it. It takes a core's time, which a second simulating thread then lacks.

Each size runs in a process of its own: *MB* is the most memory that it had, interpreter and kernels included. Runs with
one thread, and with as many as the engine thinks worth it, take turns, and the fastest of five counts, over at least a
second and, where that does not take too long, over four chunks of the recording. Time is that of frames, without
start-up. *Speed-up* is the time with one thread over that with more; the CSV file has it also for each thread
(`efficiency`). *Not kept* is a frame that nobody records, measured in turn with the others: with as many threads as
cores, writing takes time that they then lack, and with one thread it does not (`unrecorded_efficiency` is without it).
Where both rows of a size have one thread, the same program ran twice: how they differ is how still the machine was.

A run counts if nobody's state stopped being finite, no more than 2 % fell, and all runs of one size came to the same
bytes, with any number of threads.

**Other engines** simulate the hopper's body a thousand times at once, in worlds of their own: set down on its foot,
with leg spring, hip springs and a floor, but without control and without meeting one another, for 0.25 s again and
again. Ours, for comparison, is the whole frame of the crowd nearest in size: control, neighbours and recording
included. MuJoCo computes in C in float64 (`rollout`); MuJoCo Warp and Newton replay captured graphs of Warp kernels on
the CPU, which is faster than launching them, on one thread, since Warp runs a CPU launch on one. Newton reads the
model from MuJoCo's XML, and is measured with the solver it has for robots, which is MuJoCo Warp beneath, and with its
own Featherstone solver, whose springs are explicit: that one gets the largest step of a ladder at which it is sane.
They are sane if the body neither falls nor gains energy and touches the ground.

Made by `python -m echelon.benchmarks.scaling_report docs/benchmarks MACHINE`, which also writes a machine's files.
"""


def main(arguments: Sequence[str]) -> None:
    """Measure and write (see the module's text)."""
    if len(arguments) not in (1, 2):
        raise SystemExit("usage: python -m echelon.benchmarks.scaling_report FOLDER [MACHINE]")
    folder = Path(arguments[0])
    if len(arguments) == 2:
        rows = run_scaling_benchmark(progress=lambda done, total: print(f"{done} of {total}", file=sys.stderr))
        print_table(rows)
        for path in write_files(rows, folder / arguments[1]):
            print(path)
    print(write_page(folder))


if __name__ == "__main__":
    main(sys.argv[1:])
