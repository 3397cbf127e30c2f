"""`echelon tune`: a script's parameters fitted to a body and an objective."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from echelon.cli.progress import Reporter, duration
from echelon.cli.registering import Json, Quiet
from echelon.cli.running import Failure, only_json

if TYPE_CHECKING:
    from echelon.tuning import TuningProgress, TuningResult

    Tell = Callable[[TuningProgress], None]

EXAMPLES = (
    "  echelon tune standing-back-somersault --from-nothing --out my-somersault.toml\n"
    "  echelon tune standing-back-somersault --height 1.70 --mass 65 --out small-somersault.toml\n"
    "  echelon tune my-leap.toml --objective half-a-metre.toml --minutes 2 --seed 7\n"
    "  echelon tune my-leap.toml --objective half-a-metre.toml --minutes 5 --seed 7 --resume"
)

_LINE_SECONDS = 5.0
"""Where there is no terminal, a line is printed this often [s]."""


def tune(
    script: Annotated[str, typer.Argument(metavar="NAME", help="A maneuver that ships, or a script's .toml file.")],
    body: Annotated[
        str, typer.Option(metavar="male|female", help="Whose body; by default whom the script was made for.")
    ] = "",
    height: Annotated[float | None, typer.Option(metavar="M", help="Of the body [m]; by default the thesis's.")] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Of the body [kg]; by default the thesis's.")] = None,
    from_nothing: Annotated[
        bool,
        typer.Option("--from-nothing", help="Begin in the middle of the parameters' ranges, not with their values."),
    ] = False,
    objective: Annotated[
        str | None, typer.Option(metavar="NAME|FILE.toml", help="What it should be like; by default what ships for it.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.toml", help="The tuned script; by default ./SCRIPT-tuned.toml."),
    ] = None,
    minutes: Annotated[float, typer.Option(metavar="M", help="For which to search, at most.")] = 10.0,
    population: Annotated[
        int, typer.Option(metavar="N", help="Candidates a generation; by default what the objective's stages say.")
    ] = 0,
    copies: Annotated[
        int, typer.Option(metavar="N", help="Perturbed copies of each candidate; by default what the stages say.")
    ] = 0,
    seed: Annotated[int, typer.Option(metavar="K", help="Seed of candidates and perturbations.")] = 1,
    threads: Annotated[
        int, typer.Option(min=0, metavar="T", help="Threads; by default one a core. Makes no difference to the result.")
    ] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the search beside the tuned script.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit a maneuver's parameters to a body and an objective.

    Whole generations and their perturbed copies perform at once. Beside the tuned script a folder keeps the search
    after every generation, so that --resume goes on with it, and a picture of how it went. Exit code 1 says that the
    script was written, but is not as robust as the objective wants it.
    """
    from echelon.tuning import tune as carry_out

    reporter = Reporter(quiet or as_json)
    target = out
    try:
        with only_json(as_json), _telling(reporter, script) as tell:
            result = carry_out(
                script,
                objective=objective,
                body=body,
                height=height,
                mass=mass,
                from_nothing=from_nothing,
                out=out,
                minutes=minutes,
                population=population,
                copies=copies,
                seed=seed,
                resume=resume,
                threads=threads,
                progress=tell,
            )
            target = result.path
    except KeyboardInterrupt:
        raise Failure("interrupted; the same command with --resume goes on") from None
    if result.note:
        reporter.say(f"echelon: {result.note}")
    if as_json:
        print(json.dumps(result.plain()))
    elif not quiet:
        _print(result)
    if not result.done:
        raise Failure(
            f"{target}: {result.success:.0%} of {result.proof} succeed, {result.wanted:.0%} should; "
            "--resume with more --minutes goes on"
        )


def _print(result: TuningResult) -> None:
    parameters = result.script.parameters
    width = max(len(name) for name in result.values)
    tried = f"{result.performed} performances in {duration(result.seconds)}"
    rounds = "" if result.rounds == 1 else f", {result.rounds} rounds"
    print(f"{result.path}: {result.success:.0%} of {result.proof} perturbed copies succeed")
    print(f"  {len(result.history)} generations{rounds}, {tried}; objective {result.objective:.4g}")
    for name, value in result.values.items():
        print(f"  {name:<{width}}  {value:>10.5g}  {parameters[name].about}".rstrip())
    print(f"  fits body {result.script.tuned['body']}, contact {result.script.tuned['contact']}, "
          f"step {result.script.tuned['step']}")  # fmt: skip
    print(f"  how it went: {result.folder / 'convergence.png'}")


# ---- progress --------------------------------------------------------------------------------------------------------
@contextmanager
def _telling(reporter: Reporter, title: str) -> Iterator[Tell | None]:
    """A callback for progress: a bar where there is a terminal, a line now and then elsewhere."""
    if reporter.quiet:
        yield None
    elif sys.stderr.isatty():
        with _bar(title) as tell:
            yield tell
    else:
        yield _Lines(title)


def status(progress: TuningProgress) -> str:
    """'round 2, stage 1 of 3 (take-off), generation 12 of 60, best 3.21, success 83 %, at most 2 min 10 s left'."""
    again = f"round {progress.round}, " if progress.round > 1 else ""
    return (
        f"{again}stage {progress.stage} of {progress.stages} ({progress.stage_name}), generation "
        f"{progress.generation} of {progress.generations}, best {progress.best:.4g}, success {progress.success:.0%}, "
        f"at most {duration(progress.seconds_left)} left"
    )


class _Lines:
    """A plain line every few seconds."""

    def __init__(self, title: str) -> None:
        self._title, self._said = title, 0.0

    def __call__(self, progress: TuningProgress) -> None:
        now = time.monotonic()
        if now - self._said >= _LINE_SECONDS:
            self._said = now
            print(f"{self._title}: {status(progress)}", file=sys.stderr, flush=True)


@contextmanager
def _bar(title: str) -> Iterator[Tell]:
    """A bar at the foot of the terminal that goes away when the work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=10),
        TextColumn("{task.fields[status]}"),
    )
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=5, transient=True) as bar:
        task = bar.add_task(title, total=None, status="starting (the first run of a body compiles for a while)")

        def tell(progress: TuningProgress) -> None:
            # A terminal may have 80 columns.
            bar.update(
                task,
                description=f"{progress.stage}/{progress.stages} {progress.stage_name}",
                completed=progress.generation,
                total=progress.generations,
                status=f"{progress.generation}/{progress.generations}, best {progress.best:.3g}, "
                f"{progress.success:.0%}, {duration(progress.seconds_left)} left",
            )

        yield tell
