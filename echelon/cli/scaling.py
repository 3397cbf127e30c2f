"""`echelon bench scaling`: its options, which no other study has, and what it prints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from echelon.cli.progress import Reporter
from echelon.cli.running import Failure, only_json
from echelon.errors import InputError


class Crowd(StrEnum):
    """What grows."""

    HOPPERS = "hoppers"
    RIDERS = "riders"


OutFolder = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FOLDER", help="scaling, groups, thesis: write tables and plots.")
]
Only = Annotated[
    list[str] | None,
    typer.Option(
        metavar="WORD",
        help="scaling: hoppers or riders; groups: a group, problem or law (hopper-105, gap, orca), or several; "
        "thesis: an experiment or a chapter's group (leap-command, balance).",
    ),
]
Most = Annotated[int | None, typer.Option(min=1, metavar="N", help="scaling: no crowd larger than this.")]
ThreadCounts = Annotated[
    str | None,
    typer.Option(metavar="1,2,...", help="scaling: threads to compare, 0 for as many as are worth it; by default 1,0."),
]


def refuse_options(study: str, given: Mapping[str, Any]) -> None:
    """Raise InputError where a study is given an option that it does not have.

    Args:
        study: Its name.
        given: Options that only others have, by name; None where one was not given.
    """
    for name, value in given.items():
        if value is not None:
            raise InputError(f"--{name}: not for bench {study}")


def bench_scaling(
    reporter: Reporter, as_json: bool, out: Path | None, only: list[str] | None, most: int | None, threads: str | None
) -> None:
    """Measure, print, and write what was asked for."""
    from echelon.benchmarks.scaling import run_scaling_benchmark, threads_of_text
    from echelon.benchmarks.scaling_report import print_table, write_files

    if out is not None and (out.is_file() or not out.absolute().parent.is_dir()):
        raise InputError(f"--out {out}: must be the name of a folder, in one that is there")
    kind = next((crowd.value for crowd in Crowd if only == [crowd.value]), None)
    if only and kind is None:
        raise InputError(f"--only {' '.join(only)}: must be one of {', '.join(Crowd)} for bench scaling")
    counts = None if threads is None else threads_of_text(threads)
    try:
        with only_json(as_json), reporter.progress("bench scaling", "processes") as progress:
            rows = run_scaling_benchmark(only=kind, most=most, threads=counts, progress=progress)
    except RuntimeError as error:
        raise Failure(str(error)) from None
    if as_json:
        print(json.dumps(rows))
    else:
        print_table(rows)
    for path in write_files(rows, out) if out is not None else ():
        reporter.say(f"wrote {path}")
