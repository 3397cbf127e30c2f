"""A run as the command carries it out: announced, watched, turned into a stage and a film, reported."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from echelon.cli.performers import performers_report, performers_text
from echelon.cli.progress import Progress, Reporter, duration, size
from echelon.errors import InputError

if TYPE_CHECKING:
    from echelon.ranks import Ranks
    from echelon.recording import Recording
    from echelon.scenario import Scenario
    from echelon.simulation import RunCost

RepresentationName = Literal["auto", "rig", "skel", "points"]


class Failure(Exception):
    """The run failed, in one line."""


def check_products(out: Path | None, film: Path | None) -> None:
    """Find out about a misspelt folder before the run, not after it."""
    if out is not None:
        from echelon.export.stage.layer_files import checked_stage_path

        checked_stage_path(out)
    if film is not None:
        from echelon.export.picture_files import checked_path

        checked_path(film, (".mp4",))


def announce(reporter: Reporter, plan: Scenario, folder: Path) -> None:
    """Say about how long the run will take and how much disk it will use, and whether something is replaced."""
    from echelon.agents.characters import character_named
    from echelon.recording import check_place, estimate_bytes

    replaces = check_place(folder)
    character = character_named(plan.crowd.character)
    links, measures = len(character.body.links), len(character.records)
    frames, count = plan.step_count + 1, plan.crowd.count
    actors = int(plan.collie is not None)
    disk = estimate_bytes(frames, count, links, frame_rate=plan.frame_rate, actor_count=actors, measure_count=measures)
    free = shutil.disk_usage(folder.absolute().parent).free
    if disk > free:
        raise Failure(f"{folder}: the recording needs about {size(disk)}, but only {size(free)} are free there")
    if replaces:
        reporter.say(f"replacing the recording {folder}")
    if plan.performs:
        from echelon.simulation.fitting import misfits

        for line in misfits(plan):
            reporter.say(f"echelon: {line}")
    most = "at most " if plan.until else ""
    reporter.say(
        f"{plan.name}: {count} {_crowd_words(plan)}, {most}{plan.seconds:g} s at {plan.frame_rate} frames a second; "
        f"takes {most}about {duration(_expected_seconds(plan))} and {size(disk)} of disk"
    )


def _crowd_words(plan: Scenario) -> str:
    """What a scenario's characters are called together."""
    casts = plan.performance.casts if plan.performance is not None else ()
    return f"gymnasts in {len(casts)} casts" if len(casts) > 1 else f"{plan.crowd.character}s"


def _expected_seconds(plan: Scenario) -> float:
    """A rough guess of how long a run takes on one core [s]; the progress knows better once it has begun."""
    from echelon.agents.characters import character_named

    character = character_named(plan.crowd.character)
    # Work grows with the number of speeds; a hopper has 10 and takes some 30 ns a substep.
    per_substep = 3e-9 * character.body.u_count * (4.0 if plan.engine.integrator == "rk4" else 1.0)
    substeps, _ = plan.engine.stride(plan.frame_rate, character.steps_per_second, character.steps_per_tick)
    return 1.0 + plan.step_count * (1e-4 + plan.crowd.count * substeps * per_substep)


def run_and_report(
    reporter: Reporter,
    work: Callable[[Progress, RunCost], Recording],
    ranks: Ranks,
    folder: Path,
    plan: Scenario,
    out: Path | None,
    film: Path | None,
    representation: RepresentationName,
    as_json: bool,
) -> None:
    """Run, write what was asked for, report; the first of several ranks does all but the first of these."""
    from echelon.simulation import RunCost

    clock, cost = _LoopClock(), RunCost()
    with only_json(as_json):
        with _resumable(folder), reporter.progress(plan.name, "frames", plan.frame_rate) as progress:
            recording = work(clock.watched(progress), cost)
        clock.stop()
        if not ranks.is_first:
            return
        if out is not None:
            make_stage(reporter, recording, out, representation)
        unfilmed = _film_shot(reporter, recording, film) if film is not None else ""
    made = {"recording": folder, "stage": out, "film": None if unfilmed else film}
    report = _report(recording, clock, cost, made)
    if as_json:
        print(json.dumps(report))
    elif not reporter.quiet:
        print(_report_text(report, recording))
    if unfilmed:
        raise Failure(unfilmed)


def make_stage(
    reporter: Reporter,
    recording: Recording,
    out: Path,
    representation: RepresentationName,
    also: Sequence[Literal["rig", "skel", "points"]] = (),
) -> None:
    """Write a stage; where the representation was left open, say which one was chosen."""
    from echelon.export.usd import suggested_representation, write_stage

    if representation == "auto":
        representation = suggested_representation(recording.agent_count)
        others = " or ".join(name for name in ("rig", "skel", "points") if name != representation)
        reporter.say(f"{out}: {recording.agent_count} agents as {representation}; --representation takes {others} too")
    with reporter.progress(str(out), "parts") as progress:
        write_stage(recording, out, representation, progress, also=also)


def _film_shot(reporter: Reporter, recording: Recording, film: Path) -> str:
    """Make the film of the scenario's shot; returns why it could not be made on this machine, or nothing."""
    from echelon.export.pictures import render_film
    from echelon.export.renderer import RenderingUnavailable

    try:
        with reporter.progress(str(film), "pictures") as progress:
            render_film(recording, film, progress=progress, **shot_options(recording))
    except RenderingUnavailable as error:
        return f"{film}: no film was made: {error}"
    return ""


def shot_options(recording: Recording) -> dict[str, Any]:
    """What `render_film` is to be told about the shot that the recording's scenario asks for."""
    from echelon.scenario import Scenario

    shot = Scenario.from_dict(recording.scenario, source=str(recording.path)).shot
    first, last = shot.frames(recording.frame_count)
    return {
        "start": first / recording.frame_rate,
        "seconds": (last - first + 1) / recording.frame_rate,
        "fps": recording.frame_rate / shot.film_every,
        "size": shot.size,
        "camera": shot.camera,
    }


class _LoopClock:
    """Times the frame loop apart from what comes before it: starting Warp, and compiling on the first run."""

    def __init__(self) -> None:
        self.begun = time.perf_counter()
        self.first: float | None = None
        self.frames_before = 0
        self.ended = self.begun

    def watched(self, progress: Progress) -> Progress:
        """The callback, which also starts the clock when it is called first."""

        def callback(done: int, total: int) -> None:
            if self.first is None:
                self.first, self.frames_before = time.perf_counter(), done
            progress(done, total)

        return callback

    def stop(self) -> None:
        self.ended = time.perf_counter()

    @property
    def startup_seconds(self) -> float:
        return (self.first or self.begun) - self.begun

    @property
    def wall_seconds(self) -> float:
        return self.ended - (self.first or self.begun)


def _report(recording: Recording, clock: _LoopClock, cost: RunCost, made: dict[str, Path | None]) -> dict[str, Any]:
    """What a run reports; the times are of this run of the command, all else is in the recording."""
    summary = recording.summary
    simulated = (recording.frame_count - clock.frames_before) / recording.frame_rate
    report = {
        "scenario": recording.scenario["name"],
        "agents": recording.agent_count,
        "seed": recording.scenario["seed"],
        **summary,
        "wall_seconds": round(clock.wall_seconds, 4),
        "startup_seconds": round(clock.startup_seconds, 4),
        "real_time_factor": round(simulated / max(clock.wall_seconds, 1e-9), 2),
        **cost.as_dict(),
    }
    if "performers" in summary:
        report |= performers_report(recording)
    return report | {name: None if path is None else str(path) for name, path in made.items()}


def _report_text(report: dict[str, Any], recording: Recording) -> str:
    took = f"{duration(report['wall_seconds'])}, {report['real_time_factor']:.3g} x real time"
    lines = [f"{report['scenario']}: {report['agents']} agents, {report['seconds']:g} s simulated in {took}"]
    hidden = ("scenario", "agents", "seconds", "wall_seconds", "startup_seconds", "real_time_factor", "riders", "user")
    hidden += ("phase_seconds",)
    hidden += ("maneuvers", "performers", "missed_captures")
    hidden += ("in_corral",) if "riders" in report or "performers" in report else ()
    shown = {key: value for key, value in report.items() if key not in hidden and value is not None}
    width = max(len(key) for key in shown)
    lines += [f"  {key.replace('_', ' '):<{width}}  {_shown(value)}" for key, value in shown.items()]
    if "performers" in report:
        lines += performers_text(report, recording)
    return "\n".join(lines + (_standings(report) if "riders" in report else []))


def _shown(value: Any) -> str:
    return f"{value:.1f}" if isinstance(value, float) and abs(value) >= 100.0 else str(value)


STANDINGS_SHOWN = 20


def _standings(report: dict[str, Any]) -> list[str]:
    """A race's table: who came in when, who is still on the road, who fell."""
    entries = [(f"rider {index}", rider) for index, rider in enumerate(report["riders"])]
    entries += [("user", report["user"])] if report["user"] is not None else []

    def order(entry: tuple[str, dict[str, Any]]) -> tuple[float, float]:
        time = entry[1]["finish_time"]
        return (math.inf if time is None else time, -entry[1]["progress"])

    lines = ["", "       rider      time       distance  mean power  shelter"]
    for place, (name, rider) in enumerate(sorted(entries, key=order)[:STANDINGS_SHOWN], start=1):
        time, power = rider["finish_time"], rider.get("mean_power")
        came_in = "fallen" if rider.get("fallen") else "riding" if time is None else _race_time(time)
        watts = "" if power is None else f"{power:.0f} W"
        lines.append(
            f"  {place:3d}  {name:<9}  {came_in:<9}  {rider['distance'] / 1000.0:5.2f} km  {watts:>10}"
            f"  {rider['shelter']:7.0%}"
        )
    if len(entries) > STANDINGS_SHOWN:
        lines.append(f"       and {len(entries) - STANDINGS_SHOWN} more")
    return lines


def _race_time(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60.0)
    return f"{int(minutes)}:{rest:04.1f}"


@contextmanager
def only_json(as_json: bool) -> Iterator[None]:
    """Keep whatever libraries print off standard output, which is the JSON object's."""
    if as_json:
        with redirect_stdout(sys.stderr):
            yield
    else:
        yield


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    """Turn what ends a run before its time into a line that says how to go on."""
    from echelon.recording import Recording, RecordingFailed

    try:
        yield
    except KeyboardInterrupt:
        try:
            resumable = Recording(folder).status == "running"
        except InputError:  # nothing was recorded yet
            resumable = False
        hint = f"; go on with: echelon resume {folder}" if resumable else ""
        raise Failure(f"interrupted{hint}") from None
    except RecordingFailed as error:
        raise Failure(str(error)) from None
