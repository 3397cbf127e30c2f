"""What the fidelity report shows: tables on the terminal, one JSON array, a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from echelon.benchmarks.csv_rows import write_csv
from echelon.benchmarks.thesis.plots import write_pages
from echelon.benchmarks.thesis.published import EXPERIMENTS
from echelon.benchmarks.thesis.rows import FidelityRow, Range

HEADINGS = ("body", "condition", "quantity", "thesis", "human", "ours", "unit", "asked", "met")
NUMBERS = ("thesis", "human", "ours", "asked")


def print_tables(rows: Sequence[FidelityRow], console: Console | None = None) -> None:
    """Print a table for each experiment, then how many rows are as asked."""
    console = console or Console(width=None if Console().is_terminal else 160)
    for one in EXPERIMENTS:
        chosen = [row for row in rows if row.experiment == one.name]
        if not chosen:
            continue
        title = f"{one.source}: {one.title} ({one.name})"
        table = Table(title=Text(title), box=box.SIMPLE_HEAD, title_justify="left", padding=(0, 1, 0, 0))
        for heading in HEADINGS:
            table.add_column(heading, justify="right" if heading in NUMBERS else "left")
        for row in chosen:
            table.add_row(*(Text(text) for text in _cells(row)))
        console.print(table)
        for note in dict.fromkeys(row.note for row in chosen if row.note):
            console.print(f"  {note}", markup=False, highlight=False)
    console.print(verdict(rows), markup=False, highlight=False)


def verdict(rows: Sequence[FidelityRow]) -> str:
    """One line: how many rows are as asked."""
    if not rows:
        return "Nothing was measured."
    judged = [row.met for row in rows if row.met is not None]
    told = f"{len(rows) - len(judged)} more are reported without a verdict."
    return f"{sum(judged)} of {len(judged)} rows are as asked; {told}"


def write_files(rows: Sequence[FidelityRow], folder: Path) -> list[Path]:
    """Write ``thesis.csv`` and a picture of each chapter into a folder, which is made if it is not there.

    A range stands as "5 to 7", where there is no value nothing. Returns what was written.
    """
    path = folder / "thesis.csv"
    write_csv([row.plain() | {"human": _shown(row.human)} for row in rows], path)
    return [path, *write_pages(rows, folder)]


def _cells(row: FidelityRow) -> tuple[str, ...]:
    met = "" if row.met is None else "yes" if row.met else "NO"
    unit = "" if row.unit == "1" else row.unit
    return (
        row.body,
        row.condition,
        row.quantity,
        _shown(row.thesis),
        _shown(row.human),
        _shown(row.ours),
        unit,
        row.asked,
        met,
    )


def _shown(value: float | Range | None) -> str:
    if value is None:
        return ""
    return f"{value[0]:.4g} to {value[1]:.4g}" if isinstance(value, tuple) else f"{value:.4g}"
