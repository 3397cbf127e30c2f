"""`echelon sweep`: one scenario over many seeds and parameters."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from echelon.cli.progress import Reporter
from echelon.cli.registering import Json, Quiet
from echelon.cli.running import Failure, only_json

if TYPE_CHECKING:
    from echelon.sweeping import Point, SweepResult

EXAMPLES = (
    "  echelon sweep herd --seeds 1-10 --set seconds=20 --out ten-herds\n"
    "  echelon sweep border-collie --over herd.spacing=2,2.5,3 --over crowd.count=8,16 --seeds 1-5 --out spacings\n"
    "  mpiexec -n 5 echelon sweep herd --seeds 1-100 --executor mpi --out hundred-herds\n"
    "  echelon sweep herd --seeds 1-100 --executor dask --dask-address tcp://host:8786 --out hundred-herds"
)

COLUMNS_SHOWN = 6
"""Numbers that the summary on the terminal has room for."""

HIDDEN = ("state_hash",)


class ExecutorChoice(StrEnum):
    """Who carries out the runs."""

    PROCESSES = "processes"
    MPI = "mpi"
    DASK = "dask"


def sweep(
    scenario: Annotated[
        str, typer.Argument(help="Name of a scenario that ships (see `echelon list`), or a .toml file.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="The sweep's folder, with its table.")],
    over: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=V1,V2,...", help="A key of the scenario and the values to take; repeatable."),
    ] = None,
    seeds: Annotated[str | None, typer.Option(metavar="1-10", help="Seeds and ranges of seeds: 1,2,5-9.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override any key of the scenario for all runs; repeatable."),
    ] = None,
    executor: Annotated[
        ExecutorChoice,
        typer.Option(help="processes: on this machine; mpi: the ranks of mpiexec; dask: the workers of a cluster."),
    ] = ExecutorChoice.PROCESSES,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Runs at a time; by default one a core, or what there is.")
    ] = None,
    dask_address: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler that is there; by default one is started.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, metavar="T", help="Threads of each run.")] = 1,
    keep_recordings: Annotated[
        bool, typer.Option("--keep-recordings", help="Keep every run's recording in the folder.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a scenario over many seeds and parameters.

    Gathers a table, FOLDER/table.csv. The same command goes on where it stopped; what failed is tried again.
    """
    from echelon.sweeping import axis_of_text, seeds_of_text
    from echelon.sweeping import sweep as carry_out

    reporter = Reporter(quiet or as_json)
    try:
        with only_json(as_json), reporter.progress(f"sweep {scenario}", "runs") as progress:
            result = carry_out(
                scenario,
                out=out,
                over=[axis_of_text(text) for text in over or ()],
                seeds=None if seeds is None else seeds_of_text(seeds),
                settings=list(settings or ()),
                executor=executor.value,
                workers=workers,
                dask_address=dask_address,
                threads=threads,
                keep_recordings=keep_recordings,
                progress=progress,
            )
    except KeyboardInterrupt:
        raise Failure(f"interrupted; the same command goes on with {out}") from None
    if result is None:  # one of the workers that mpiexec started
        return
    if as_json:
        print(json.dumps(_report(result)))
    elif not quiet:
        _print(result)
    if result.failed:
        first = result.failed[0]
        raise Failure(
            f"{len(result.failed)} of {len(result.rows)} runs failed (see {result.csv}); run {first['run']}: "
            f"{first['why']}"
        )


def _report(result: SweepResult) -> dict[str, Any]:
    """The JSON object."""
    return {
        "sweep": str(result.path),
        "table": str(result.csv),
        "runs": len(result.rows),
        "ran": result.ran,
        "failed": len(result.failed),
        "points": [point.plain() for point in result.points],
    }


def _print(result: SweepResult) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from echelon.sweeping import telling

    points = result.points
    names = [name for name in telling(points) if name not in HIDDEN]
    shown = names[:COLUMNS_SHOWN]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in (*result.keys, "runs", *(name.replace("_", " ") for name in shown)):
        table.add_column(Text(heading), justify="right")
    for point in points:
        table.add_row(
            *(Text(_value(point.parameters[key])) for key in result.keys),
            f"{point.done}" if point.done == point.runs else f"{point.done} of {point.runs}",
            *(_spread(point, name) for name in shown),
        )
    console = Console()
    console.print(table)
    again = len(result.rows) - result.ran
    lines = ["Mean (least to most) over the seeds."] if shown else ["All runs reported the same numbers."]
    if len(names) > len(shown):
        lines.append(f"Also in the table: {', '.join(names[len(shown) :])}.")
    before = f", {again} of them before" if again else ""
    lines.append(f"{len(result.rows)} runs{before}: {result.csv}")
    for line in lines:
        console.print(line, markup=False, highlight=False)


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _spread(point: Point, name: str) -> str:
    spread = point.numbers.get(name)
    if spread is None:
        return "–"
    if spread.least == spread.most:
        return f"{spread.mean:.4g}"
    return f"{spread.mean:.4g} ({spread.least:.4g} to {spread.most:.4g})"
