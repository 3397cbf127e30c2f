"""`echelon bench thesis`: what it prints and writes."""

from __future__ import annotations

import json
from pathlib import Path

from echelon.cli.progress import Reporter
from echelon.cli.running import only_json
from echelon.errors import InputError


def bench_thesis(reporter: Reporter, as_json: bool, out: Path | None, only: list[str] | None) -> None:
    """Run the experiments, print, and write what was asked for.

    Args:
        reporter: Says how far it is.
        as_json: Print one JSON array, and nothing else.
        out: Folder for the table as a file.
        only: Names of experiments or groups; all that are measured if None.

    Raises:
        InputError: A name is none of them, or ``out`` cannot be a folder.
    """
    from echelon.benchmarks.thesis import print_tables, run_thesis_benchmark, write_files

    if out is not None and (out.is_file() or not out.absolute().parent.is_dir()):
        raise InputError(f"--out {out}: must be the name of a folder, in one that is there")
    with only_json(as_json), reporter.progress("bench thesis", "experiments") as progress:
        rows = run_thesis_benchmark(only=only or (), progress=progress)
    if as_json:
        print(json.dumps([row.plain() for row in rows]))
    else:
        print_tables(rows)
    for path in write_files(rows, out) if out is not None else ():
        reporter.say(f"wrote {path}")
