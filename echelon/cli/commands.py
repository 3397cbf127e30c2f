"""The `echelon` command.

Exit codes: 0 done, 1 the run failed, 2 the input is wrong. Whatever goes wrong is one line on standard error; what a
command produces goes to standard output, what it says about its progress to standard error.

What a command needs is imported when the command runs, so that `echelon --help` is there at once.
"""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from echelon.cli.captures import EXAMPLES as CAPTURES_EXAMPLES
from echelon.cli.captures import captures
from echelon.cli.course import app as course_app
from echelon.cli.groups import Seeds, bench_groups
from echelon.cli.play import EXAMPLES as PLAY_EXAMPLES
from echelon.cli.play import play
from echelon.cli.products import (
    EXPORT_EXAMPLES,
    PLOT_EXAMPLES,
    RENDER_EXAMPLES,
    RecordingFolder,
    RepresentationChoice,
    RepresentationOption,
    export,
    plot,
    render,
)
from echelon.cli.progress import Progress, Reporter
from echelon.cli.registering import Json, Quiet, command
from echelon.cli.running import Failure, announce, check_products, only_json, run_and_report
from echelon.cli.scaling import Most, Only, OutFolder, ThreadCounts, bench_scaling, refuse_options
from echelon.cli.sweep import EXAMPLES as SWEEP_EXAMPLES
from echelon.cli.sweep import sweep
from echelon.cli.thesis import bench_thesis
from echelon.cli.tune import EXAMPLES as TUNE_EXAMPLES
from echelon.cli.tune import tune
from echelon.errors import InputError
from echelon.launcher import launched_rank, launched_ranks

if TYPE_CHECKING:
    from echelon.ranks import Ranks
    from echelon.recording import Recording
    from echelon.simulation import RunCost

DONE, FAILED, WRONG_INPUT = 0, 1, 2
OTHERS_WAIT = 2.0  # [s]; so long ranks but the first keep back what they complain of

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]  # click's, or that of the copy that typer carries

app = typer.Typer(
    name="echelon",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich takes longer to draw the help than all else that happens until then
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    help="Crowds that obey physics, as finished OpenUSD.",
    epilog="\b\nBegin with:\n  echelon simulate border-collie --out herd.usd --film herd.mp4",
)


def main() -> None:
    """Entry point of the command."""
    code = run(sys.argv[1:]) if launched_ranks() == 1 else _run_on_ranks(sys.argv[1:])
    sys.exit(code)


def _run_on_ranks(arguments: list[str]) -> int:
    """Run the command on several ranks: where one fails, it says why and ends all, which would wait for it for ever."""
    rank = launched_rank()

    def complain(message: str, code: int) -> int:
        # What is wrong with the input all find at once: the first says so, and ends the others meanwhile, which it can
        # as soon as all have come to MPI.
        if rank:
            _all_ranks()
            time.sleep(OTHERS_WAIT)
        return _complain(f"rank {rank}: {message}" if rank else message, code)

    try:
        code = run(arguments, complain)
    except Exception as error:
        traceback.print_exc()
        code = complain(f"{type(error).__name__}: {error}; all ranks stop", FAILED)
    if code != DONE:
        sys.stderr.flush()
        ranks = _all_ranks()
        if ranks is not None:
            ranks.abort(code)
    return code


def _all_ranks() -> Ranks | None:
    """All that were launched; None without mpi4py, where the launcher ends the others when one leaves."""
    from echelon.ranks import Ranks

    try:
        return Ranks.launched()
    except InputError:
        return None


def run(arguments: list[str], complain: Callable[[str, int], int] | None = None) -> int:
    """Run the command; returns its exit code.

    Args:
        arguments: As on the command line, the command's own name left out.
        complain: Takes the line that says what went wrong, and the exit code, and returns that; by default it prints
            on standard error.
    """
    complain = complain or _complain
    try:
        code = app(args=arguments, prog_name="echelon", standalone_mode=False)
        return code if isinstance(code, int) else DONE
    except InputError as error:
        return complain(str(error), WRONG_INPUT)
    except _UsageError as error:
        message = str(getattr(error, "format_message", error.__str__)()).rstrip(".")
        path = getattr(getattr(error, "ctx", None), "command_path", "echelon")
        return complain(f"{message}; try '{path} --help'", WRONG_INPUT)
    except Failure as error:
        return complain(str(error), FAILED)
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        return complain(f"{name}{error.strerror or error}", FAILED)
    except MemoryError:
        return complain("out of memory", FAILED)


def _complain(message: str, code: int) -> int:
    print(f"echelon: {' '.join(message.split())}", file=sys.stderr)
    return code


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        print(f"echelon {installed('echelon')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


# ---- options that several commands share ---------------------------------------------------------------------------
Threads = Annotated[int | None, typer.Option(min=1, metavar="T", help="Threads; by default as many as are worth it.")]
Stage = Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.usd", help="Write a USD stage.")]
Film = Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Make a film of the scenario's shot.")]


Device = Annotated[
    str, typer.Option(metavar="DEVICE", help="Where to compute: cpu, cuda (the first GPU there is) or cuda:N.")
]


class Study(StrEnum):
    """What can be measured."""

    ENGINE = "engine"
    BICYCLE = "bicycle"
    TERRAIN = "terrain"
    SCALING = "scaling"
    GROUPS = "groups"
    THESIS = "thesis"


# ---- simulate and resume -------------------------------------------------------------------------------------------
@command(
    app,
    "simulate",
    "  echelon simulate border-collie --out herd.usd --film herd.mp4\n"
    "  echelon simulate herd --agents 105 --seconds 60 --seed 7\n"
    "  echelon simulate my-scene.toml --set herd.spacing=3 --set world.fence_height=1 --json\n"
    "  echelon simulate olympic-race --course ride.gpx --out race.usd",
)
def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="Name of a scenario that ships (see `echelon list`), a .toml file, or a recording to simulate again."
        ),
    ],
    agents: Annotated[int | None, typer.Option(min=1, metavar="N", help="How many characters.")] = None,
    seconds: Annotated[float | None, typer.Option(metavar="S", help="How long to simulate, at most.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, metavar="K", help="Seed of what happens at random.")] = None,
    course: Annotated[
        str | None,
        typer.Option(metavar="COURSE", help="Ride on this course: a name, a .toml file, or a GPS track (.gpx)."),
    ] = None,
    threads: Threads = None,
    device: Device = "cpu",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override any key of the scenario; repeatable."),
    ] = None,
    out: Stage = None,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where to record; by default beside the stage, or ./SCENARIO.recording."),
    ] = None,
    film: Film = None,
    representation: RepresentationOption = RepresentationChoice.AUTO,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a scenario: recording, stage, film.

    The stage and the film are made if asked for. The recording is written as the run goes on: killed at any moment,
    it is gone on with by `echelon resume`.
    """
    from echelon.ranks import Ranks
    from echelon.recording import Recording, is_recording
    from echelon.scenario import Scenario

    overrides = list(settings or ())
    for key, value in (("crowd.count", agents), ("seconds", seconds), ("seed", seed), ("world.course", course)):
        overrides += [f"{key}={value}"] if value is not None else []
    controls = None
    if is_recording(Path(scenario)):
        again = Recording(scenario)
        plan = Scenario.from_dict(again.scenario, source=scenario, overrides=overrides)
        controls = again.controls[:] if again.control_names else None
    else:
        plan = Scenario.load(scenario, overrides)
    if device != "cpu":
        from echelon.warp_kernels.start import checked_device

        device = checked_device(device)
    ranks = Ranks.launched()
    folder = recording or (out.with_suffix(".recording") if out is not None else Path(f"{plan.name}.recording"))
    if is_recording(Path(scenario)) and folder.exists() and folder.samefile(scenario):
        raise InputError(f"{folder}: is what is to be simulated again; name another with --recording")
    reporter = Reporter(quiet or as_json or not ranks.is_first)
    if ranks.is_first:
        check_products(out, film)
        most = plan if controls is None else replace(plan, seconds=max(len(controls) - 1, 1) / plan.frame_rate)
        announce(reporter, most, folder)

    def work(progress: Progress, cost: RunCost) -> Recording:
        from echelon.simulation import simulate

        return simulate(
            plan,
            recording=folder,
            threads=threads,
            progress=progress,
            device=device,
            ranks=ranks,
            cost=cost,
            controls=controls,
        )

    run_and_report(reporter, work, ranks, folder, plan, out, film, representation.value, as_json)


@command(app, "resume", "  echelon resume herd.recording --out herd.usd")
def resume(
    recording: RecordingFolder,
    threads: Threads = None,
    device: Device = "cpu",
    out: Stage = None,
    film: Film = None,
    representation: RepresentationOption = RepresentationChoice.AUTO,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Go on with a run that was interrupted.

    It ends with the same bytes as if it had not been.
    """
    from echelon.ranks import Ranks
    from echelon.recording import Recording
    from echelon.scenario import Scenario

    opened = Recording(recording)
    if opened.status == "done":
        raise InputError(f"{recording}: this recording is finished ({opened.frame_count} frames); nothing to resume")
    plan = Scenario.from_dict(opened.scenario, source=str(recording))
    ranks = Ranks.launched()
    reporter = Reporter(quiet or as_json or not ranks.is_first)
    if ranks.is_first:
        check_products(out, film)
    reporter.say(
        f"{plan.name}: going on after {opened.frame_count} frames of at most {plan.step_count + 1}; when it was "
        f"interrupted at most a chunk, {opened.chunk_frames} frames, was lost"
    )

    def work(progress: Progress, cost: RunCost) -> Recording:
        from echelon.simulation import resume

        return resume(recording, threads=threads, progress=progress, device=device, ranks=ranks, cost=cost)

    run_and_report(reporter, work, ranks, recording, plan, out, film, representation.value, as_json)


command(app, "play", PLAY_EXAMPLES)(play)
command(app, "sweep", SWEEP_EXAMPLES)(sweep)
command(app, "tune", TUNE_EXAMPLES)(tune)


command(app, "export", EXPORT_EXAMPLES)(export)
command(app, "render", RENDER_EXAMPLES)(render)
command(app, "plot", PLOT_EXAMPLES)(plot)
command(app, "captures", CAPTURES_EXAMPLES)(captures)


# ---- bench, list, describe -----------------------------------------------------------------------------------------
@command(
    app,
    "bench",
    "  echelon bench engine\n  echelon bench engine --json > engine.json\n  echelon bench bicycle\n"
    "  echelon bench scaling --only hoppers --most 1000 --out scaling\n"
    "  echelon bench groups --only hopper-105 --only gap --seeds 3",
)
def bench(
    study: Annotated[
        Study,
        typer.Argument(
            help="engine: how fast bodies are simulated, beside MuJoCo; "
            "bicycle: whether one balances itself at the speeds at which it should; "
            "terrain: how fast the ground can be asked for its height; "
            "scaling: what a frame costs as crowds grow; "
            "groups: how well they hold together, turn, and pass obstacles; "
            "thesis: what people do in the experiments of a thesis, beside its numbers."
        ),
    ],
    out: OutFolder = None,
    only: Only = None,
    most: Most = None,
    threads: ThreadCounts = None,
    seeds: Seeds = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON array, and nothing else.")] = False,
    quiet: Quiet = False,
) -> None:
    """Measure how fast Echelon is on this machine, or how true."""
    reporter = Reporter(quiet or as_json)
    if study is Study.SCALING:
        refuse_options(study, {"seeds": seeds})
        bench_scaling(reporter, as_json, out, only, most, threads)
        return
    if study is Study.GROUPS:
        refuse_options(study, {"most": most, "threads": threads})
        bench_groups(reporter, as_json, out, only, seeds)
        return
    if study is Study.THESIS:
        refuse_options(study, {"most": most, "threads": threads, "seeds": seeds})
        bench_thesis(reporter, as_json, out, only)
        return
    refuse_options(study, {"out": out, "only": only, "most": most, "threads": threads, "seeds": seeds})
    if study is Study.BICYCLE:
        from echelon.benchmarks.bicycle import print_table
        from echelon.benchmarks.bicycle import run_bicycle_benchmark as run_benchmark
    elif study is Study.TERRAIN:
        from echelon.benchmarks.terrain import print_table
        from echelon.benchmarks.terrain import run_terrain_benchmark as run_benchmark
    else:
        from echelon.benchmarks.engine import run_engine_benchmark as run_benchmark
        from echelon.benchmarks.engine_report import print_table

    with only_json(as_json), reporter.progress(f"bench {study}", "measurements") as progress:
        rows = run_benchmark(progress=progress)
    if as_json:
        print(json.dumps(rows))
    else:
        print_table(rows)


@command(app, "list", "  echelon list\n  echelon list --json")
def list_(as_json: Json = False) -> None:
    """List what ships: scenarios, maneuvers, courses, bodies, characters."""
    from echelon.cli.description import shipped

    found = shipped()
    if as_json:
        print(json.dumps(found))
        return
    width = max(len(name) for names in found.values() for name in names)
    for kind, names in found.items():
        print(f"{kind}:")
        for name, line in names.items():
            print(f"  {name:<{width}}  {line}")


@command(
    app,
    "describe",
    "  echelon describe border-collie\n  echelon describe male\n  echelon describe herd.recording --json",
)
def describe(
    what: Annotated[
        str, typer.Argument(metavar="SCENARIO|MANEUVER|BODY|RECORDING", help="A name, a file or a folder.")
    ],
    as_json: Json = False,
) -> None:
    """Describe a scenario, a maneuver, a body or a recording.

    A scenario is printed as the whole of its file, defaults included: a good beginning for one of your own.
    """
    from echelon.cli.description import describe as described

    data, text = described(what)
    print(json.dumps(data) if as_json else text)


app.add_typer(course_app)
