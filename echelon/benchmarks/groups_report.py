"""What `echelon bench groups` found, for the documentation: a machine's table, plots, and the table on the page.

    python -m echelon.benchmarks.groups_report docs MACHINE

runs the benchmark into ``docs/benchmarks/MACHINE/groups.csv``, draws ``docs/benchmarks/groups.png`` and
``groups-paths.png``, and writes the table on the page ``docs/groups.md`` anew; without MACHINE it only writes the
table, from the files that are there.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from echelon.benchmarks.csv_rows import read_csv, write_csv
from echelon.benchmarks.group_plots import write_paths, write_summary
from echelon.benchmarks.group_problems import ORCA, PAPER, chosen_tests
from echelon.benchmarks.group_run import run_test
from echelon.benchmarks.groups import COLUMNS, run_groups_benchmark, shown_row

Row = dict[str, Any]

START, END = "<!-- table -->\n", "<!-- end -->"
SHOWN = ("hopper-105", "cyclist-18")
"""The groups whose ways are drawn, with obstacles, by each law, with the first seed."""


def markdown(rows: Sequence[Row]) -> str:
    """The table of a machine's rows."""
    head = ["clean seeds" if name == "clean" else name for name in COLUMNS]
    lines = [" | ".join(head), " | ".join(["---"] * 3 + ["---:"] * (len(head) - 3))]
    lines += [" | ".join(shown_row(row, "{} {}", "{} of {}")) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def write_table(folder: Path) -> Path:
    """Write the table on the page from the first machine's file; returns the page's path."""
    page = folder / "groups.md"
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(START)
    rows = read_csv(sorted(folder.glob("benchmarks/*/groups.csv"))[0])
    page.write_text(before + START + markdown(rows) + END + rest.partition(END)[2], encoding="utf-8")
    return page


def draw_ways(path: Path) -> Path:
    """Run and draw the tests with obstacles of `SHOWN`."""
    chosen = [test for test in chosen_tests(SHOWN) if test.problem in ("gap", "columns")]
    names = {PAPER: "Brogan and Hodgins", ORCA: "ORCA"}
    titles = [
        f"{test.group.count} {test.group.character}s, {test.problem}: {names.get(test.law, test.law)}"
        for test in chosen
    ]
    return write_paths([(title, run_test(test, 1)) for title, test in zip(titles, chosen, strict=True)], path)


def main(arguments: Sequence[str]) -> None:
    """Run and write (see the module's text)."""
    if len(arguments) not in (1, 2):
        raise SystemExit("usage: python -m echelon.benchmarks.groups_report FOLDER [MACHINE]")
    folder = Path(arguments[0])
    if len(arguments) == 2:
        rows = run_groups_benchmark(progress=lambda done, total: print(f"{done} of {total}", file=sys.stderr))
        write_csv(rows, folder / "benchmarks" / arguments[1] / "groups.csv")
        print(write_summary(rows, folder / "benchmarks" / "groups.png"))
        print(draw_ways(folder / "benchmarks" / "groups-paths.png"))
    print(write_table(folder))


if __name__ == "__main__":
    main(sys.argv[1:])
