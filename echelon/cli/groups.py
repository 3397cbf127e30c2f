"""`echelon bench groups`: its options, and what it prints and writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from echelon.cli.progress import Reporter
from echelon.cli.running import only_json
from echelon.errors import InputError

Seeds = Annotated[int | None, typer.Option(min=1, metavar="N", help="groups: runs of each test, 10 by default.")]


def bench_groups(
    reporter: Reporter, as_json: bool, out: Path | None, only: list[str] | None, seeds: int | None
) -> None:
    """Run the tests, print, and write what was asked for."""
    from echelon.benchmarks.groups import SEEDS, print_table, run_groups_benchmark, write_files

    if out is not None and (out.is_file() or not out.absolute().parent.is_dir()):
        raise InputError(f"--out {out}: must be the name of a folder, in one that is there")
    with only_json(as_json), reporter.progress("bench groups", "runs") as progress:
        rows = run_groups_benchmark(seeds=seeds or SEEDS, only=only or (), progress=progress)
    if as_json:
        print(json.dumps(rows))
    else:
        print_table(rows)
    for path in write_files(rows, out) if out is not None else ():
        reporter.say(f"wrote {path}")
