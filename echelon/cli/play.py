"""`echelon play`: a person in the herd or in the peloton, live in a browser; and recordings with a timeline."""

from __future__ import annotations

import importlib.util
import signal
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from echelon.cli.progress import Reporter, size
from echelon.cli.registering import Quiet
from echelon.errors import InputError

if TYPE_CHECKING:
    from echelon.play.live import Live
    from echelon.play.showing import Showing
    from echelon.play.trainer.trainer import Trainer
    from echelon.recording import Recording

EXAMPLES = (
    "  echelon play border-collie\n"
    "  echelon play olympic-race --set crowd.count=18\n"
    "  echelon play --replay herd.recording\n"
    "  echelon play --continue border-collie-take-1.recording --from 12.5"
)

LOOPBACK = "127.0.0.1"


def play(
    scenario: Annotated[
        str | None,
        typer.Argument(metavar="SCENARIO", help="A scenario that ships (see `echelon list`), or a .toml file."),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a setting; may be repeated.")
    ] = None,
    agents: Annotated[int | None, typer.Option(help="How many characters.", min=1)] = None,
    seed: Annotated[int | None, typer.Option(help="Of what happens at random.", min=0)] = None,
    takes: Annotated[Path, typer.Option(metavar="FOLDER", help="Where takes are recorded.")] = Path("."),
    replay: Annotated[
        Path | None, typer.Option(metavar="RECORDING", help="Show a recording with a timeline instead.")
    ] = None,
    go_on: Annotated[
        Path | None, typer.Option("--continue", metavar="TAKE", help="Go on with a take, as another take.")
    ] = None,
    begin: Annotated[
        float | None,
        typer.Option("--from", metavar="SECONDS", help="From when on somebody else rides; default: its end.", min=0.0),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines in.")] = LOOPBACK,
    port: Annotated[
        int, typer.Option(help="Port to listen on, or the next free one; 0 for any.", min=0, max=65535)
    ] = 8080,
    browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in this machine's browser.")] = True,
    trainer: Annotated[
        str | None,
        typer.Option(metavar="nearest|ADDRESS", help="A bicycle trainer (Bluetooth) whose power drives the avatar."),
    ] = None,
    pitch: Annotated[
        str | None,
        typer.Option(metavar="[HOST:]PORT", help="Where a motion platform takes its pitch; needs --trainer."),
    ] = None,
    threads: Annotated[int | None, typer.Option(help="Of the simulation; 0 decides by the work there is.")] = None,
    device: Annotated[str, typer.Option(help="A Warp device: cpu, cuda or cuda:1.")] = "cpu",
    quiet: Quiet = False,
) -> None:
    """Ride with them, live in a browser: be the collie, or race with the peloton.

    Starts the simulation at wall-clock pace and a page with the world; whoever takes the handlebars rides. What
    they do is recorded: a take is a recording, exported like any other, and simulated again to the same bytes by
    `echelon resume` and `echelon simulate --take`.
    """
    reporter = Reporter(quiet)
    _check(scenario, replay, go_on, begin, settings, agents, seed, trainer, pitch)
    _check_extra()
    from echelon.play.session import Session

    stop = threading.Event()
    machine = _trainer(trainer, pitch, reporter)
    live: Live | None = None
    try:
        if replay is not None:
            from echelon.play.replayed import Replayed
            from echelon.recording import Recording

            showing: Showing = Replayed(Recording(replay))
        else:
            showing = live = _live(
                scenario, settings, agents, seed, takes, go_on, begin, machine, threads, device, reporter
            )
        session = Session(showing, host=host, port=port)
        before = {kind: signal.signal(kind, lambda *_: stop.set()) for kind in (signal.SIGINT, signal.SIGTERM)}
        try:
            session.run(stop, lambda url: _announce(url, host, browser, reporter))
        finally:
            for kind, handler in before.items():
                signal.signal(kind, handler)
    finally:
        if machine is not None:
            machine.stop()
    if live is not None:
        _say_what_was_kept(live, reporter)


def _check(
    scenario: str | None,
    replay: Path | None,
    go_on: Path | None,
    begin: float | None,
    settings: list[str] | None,
    agents: int | None,
    seed: int | None,
    trainer: str | None,
    pitch: str | None,
) -> None:
    """Refuse what does not go together."""
    given = [name for name, value in (("SCENARIO", scenario), ("--replay", replay), ("--continue", go_on)) if value]
    if len(given) != 1:
        found = f"{' and '.join(given)} were given" if given else "none was given"
        raise InputError(f"play: takes one of SCENARIO, --replay RECORDING and --continue TAKE; {found}")
    if scenario is None:
        for name, value in (("--set", settings), ("--agents", agents), ("--seed", seed)):
            if value:
                raise InputError(f"{name}: changes a scenario; {given[0]} has one already")
    if begin is not None and go_on is None:
        raise InputError("--from: says from when on a take is gone on with; needs --continue TAKE")
    if replay is not None and trainer is not None:
        raise InputError("--trainer: nobody rides in a recording; leave it out with --replay")
    if pitch is not None and trainer is None:
        raise InputError("--pitch: is driven beside a trainer; needs --trainer")


def make_page(
    reporter: Reporter,
    recording: Recording,
    out: Path,
    *,
    start: float = 0.0,
    seconds: float | None = None,
    fps: float | None = None,
) -> None:
    """Save a recording as a page to send to somebody.

    Raises:
        InputError: The package is not installed, the page cannot be written, or the recording has no such time.
    """
    _check_extra()
    from echelon.play.drawing.saved_page import FRAMES_PER_SECOND, save_page

    rate, count = recording.frame_rate, recording.frame_count
    first = round(start * rate)
    last = count if seconds is None else min(first + max(round(seconds * rate), 1), count)
    if not 0 <= first < count:
        raise InputError(f"--start {start:g}: must be from 0 to {(count - 1) / rate:g} s")
    pictures = FRAMES_PER_SECOND if fps is None else max(round(fps), 1)
    with reporter.progress(str(out), "pictures") as progress:
        save_page(recording, out, first=first, last=last, frames_per_second=pictures, progress=progress)
    reporter.say(f"wrote {out} ({size(out.stat().st_size)})")


def _check_extra() -> None:
    if importlib.util.find_spec("viser") is None:
        raise InputError("the package viser is not installed; `pip install 'echelon[play]'` adds it")


def _trainer(address: str | None, pitch: str | None, reporter: Reporter) -> Trainer | None:
    """The trainer, connected; None without one."""
    if address is None:
        return None
    from echelon.play.trainer.machine_address import NEAREST
    from echelon.play.trainer.pitch import DatagramPitch
    from echelon.play.trainer.trainer import Trainer

    output = None if pitch is None else DatagramPitch.at(pitch)
    machine = Trainer(NEAREST if address == "nearest" else address, pitch=output, say=reporter.say)
    reporter.say("looking for a trainer")
    machine.start()
    return machine


def _live(
    scenario: str | None,
    settings: list[str] | None,
    agents: int | None,
    seed: int | None,
    folder: Path,
    go_on: Path | None,
    begin: float | None,
    machine: Trainer | None,
    threads: int | None,
    device: str,
    reporter: Reporter,
) -> Live:
    from echelon.play.live import Live
    from echelon.play.takes import Take, ridable
    from echelon.recording import Recording
    from echelon.scenario import Scenario

    if not folder.is_dir():
        raise InputError(f"--takes {folder}: there is no such folder")
    options: dict[str, Any] = {"threads": threads, "device": device}
    if go_on is not None:
        after = Recording(go_on)
        plan = Scenario.from_dict(after.scenario, source=str(go_on))
        frame = after.frame_count if begin is None else round(begin * after.frame_rate)
        first = [{"after": after, "frame": frame}]  # a restart begins anew
        reporter.say(f"{go_on}: going on from {frame / after.frame_rate:g} s")
    else:
        changes = list(settings or [])
        changes += [f"crowd.count={agents}"] if agents is not None else []
        changes += [f"seed={seed}"] if seed is not None else []
        plan, first = ridable(Scenario.load(str(scenario), changes)), [{}]

    def begun(plan: Scenario, path: Path) -> Take:
        return Take(plan, path, **options, **(first.pop() if first else {}))

    reporter.say(f"{plan.name}: getting ready (kernels are compiled when a character runs for the first time)")
    return Live(begun, plan, folder, trainer=machine, say=reporter.say)


def _announce(url: str, host: str, browser: bool, reporter: Reporter) -> None:
    reporter.say(f"ride at {url}  (Ctrl-C ends)")
    if host not in (LOOPBACK, "localhost", "::1"):
        reporter.say(f"anybody who reaches {host} can ride and watch: there is no password")
    if browser:
        webbrowser.open(url)


def _say_what_was_kept(live: Live, reporter: Reporter) -> None:
    for path, seconds in live.kept:
        reporter.say(f"take {path}: {seconds:.1f} s; a stage of it: echelon export {path} --out {path.stem}.usd")
