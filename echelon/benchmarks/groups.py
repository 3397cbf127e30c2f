"""`echelon bench groups`: how well groups with dynamics hold together, turn, and pass obstacles.

Three kinds of group (point masses, hopping robots, cyclists) and four test problems (`group_problems`), each over many
seeds, by three laws: the published one, our own for this character, and ORCA, a kinematic planner. Point masses show
what a law is worth where bodies do as they are told; what the same law does with robots and cyclists shows what their
dynamics cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from echelon.benchmarks.csv_rows import write_csv
from echelon.benchmarks.group_plots import write_summary
from echelon.benchmarks.group_problems import ORCA, GroupTest, chosen_tests
from echelon.benchmarks.group_run import Outcome, outcome, run_test
from echelon.benchmarks.orca import PACKAGE, orca_version
from echelon.warp_kernels.start import start_warp

Progress = Callable[[int, int], None]
Row = dict[str, Any]

SEEDS = 10


def run_groups_benchmark(
    *, seeds: int = SEEDS, only: Sequence[str] = (), progress: Progress | None = None, chosen: Iterable[GroupTest] = ()
) -> list[Row]:
    """Run the tests; a row for each group, problem and law.

    Args:
        seeds: How many runs of each, with seeds 1, 2, ...
        only: Words that name groups, problems or laws; see `group_problems.chosen_tests`.
        progress: Called with (runs done, runs).
        chosen: Tests to run instead of those that ship.

    Raises:
        InputError: A word in `only` names nothing, or ORCA is asked for and not installed.
    """
    start_warp()
    todo = list(chosen) or chosen_tests(only)
    if ORCA not in only and not orca_version():
        todo = [test for test in todo if test.law != ORCA]
    rows = []
    for index, test in enumerate(todo):
        found = []
        for seed in range(1, seeds + 1):
            found.append(outcome(run_test(test, seed)))
            if progress is not None:
                progress(index * seeds + seed, len(todo) * seeds)
        rows.append(_row(test, found))
    return rows


def _row(test: GroupTest, found: Sequence[Outcome]) -> Row:
    """What all seeds of a test came to."""

    def mean(name: str) -> float | None:
        values = np.array([getattr(one, name) for one in found], dtype=float)
        values = values[np.isfinite(values)]
        return round(float(values.mean()), 4) if len(values) else None

    agents = sum(one.agents for one in found)
    return {
        "character": test.group.character,
        "agents": test.group.count,
        "problem": test.problem,
        "law": test.law,
        "seeds": len(found),
        "clean": sum(one.clean for one in found),
        "falls": sum(one.falls for one in found),
        "collisions": sum(one.collisions for one in found),
        "crossed": sum(one.crossed for one in found),
        "passed_percent": round(100.0 * sum(one.passed for one in found) / agents, 3),
        "lost_percent": round(100.0 * sum(one.lost for one in found) / agents, 3),
        "dispersion": mean("dispersion"),
        "recovery_s": mean("recovery"),
        "recovered": sum(bool(np.isfinite(one.recovery)) for one in found) if test.problem == "turning" else None,
        "distance_m": mean("distance"),
        "nearest_m": round(min(one.nearest for one in found), 4),
        "off_speed_m_s": mean("off_speed"),
    }


COLUMNS = (
    *("group", "problem", "law", "clean", "falls", "collisions", "crossed", "passed", "lost"),
    *("spread", "recovery", "distance", "nearest"),
)
"""What a table shows of a row; the first three are words, the others numbers."""


def shown_row(row: Row, group: str, clean: str) -> tuple[str, ...]:
    """A row as tables show it, by `COLUMNS`; how a table writes "agents, character" and "clean, seeds" it says."""
    return (
        group.format(row["agents"], row["character"]),
        row["problem"],
        row["law"],
        clean.format(row["clean"], row["seeds"]),
        str(row["falls"]),
        str(row["collisions"]),
        str(row["crossed"]),
        f"{row['passed_percent']:.1f} %",
        f"{row['lost_percent']:.1f} %",
        _shown(row["dispersion"], "{:.2f}"),
        _shown(row["recovery_s"], "{:.1f} s"),
        _shown(row["distance_m"], "{:.2f} m"),
        _shown(row["nearest_m"], "{:.2f} m"),
    )


def print_table(rows: Sequence[Row]) -> None:
    """Print rows as a table."""
    count = rows[0]["seeds"] if rows else 0
    table = Table(box=box.SIMPLE_HEAD, title=f"Group tests over {count} seeds", title_justify="left")
    for place, name in enumerate(COLUMNS):
        table.add_column(name, justify="left" if place < 3 else "right", no_wrap=True)
    before = None
    for row in rows:
        cells = shown_row(row, "{} x {}", "{}/{}")
        if before is not None and cells[:2] != before:
            table.add_section()
        before = cells[:2]
        table.add_row(*cells)
    console = Console(width=None if Console().is_terminal else 160)
    console.print(table)
    console.print(
        "clean: seeds without fall, collision or crossing; collisions: centres came nearer than two radii; crossed: "
        "agents whose bodies went through another deeper than 5 cm; lost: fell, did not pass, or crossed; spread: rms "
        "distance from the middle, end over start; recovery: from the turn until all keep within 15 % of the new "
        "velocity.",
        highlight=False,
    )
    if not orca_version():
        console.print(f"ORCA: left out, since {PACKAGE} is not installed (pip install echelon\\[bench]).")


def write_files(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write ``groups.csv`` and ``groups.png`` into a folder, which is made if it is not there; returns their paths."""
    folder.mkdir(exist_ok=True)
    table, picture = folder / "groups.csv", folder / "groups.png"
    write_csv(rows, table)
    return [table, write_summary(rows, picture)]


def _shown(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
