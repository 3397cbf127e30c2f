"""What is made of a recording: `echelon export`, `render` and `plot`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from echelon.cli.play import make_page
from echelon.cli.progress import Reporter, size
from echelon.cli.registering import Quiet
from echelon.cli.running import Failure, make_stage, shot_options
from echelon.errors import InputError

EXPORT_EXAMPLES = (
    "  echelon export herd.recording --out herd.usd\n"
    "  echelon export herd.recording --out crowd.usd --representation points\n"
    "  echelon export herd.recording --out frame90.usda --physics 90"
)
RENDER_EXAMPLES = (
    "  echelon render herd.recording --out herd.mp4\n"
    "  echelon render herd.usd --out close.mp4 --start 10 --seconds 5 --size 1280x720\n"
    "  echelon render herd.recording --out still.png --time 12.5\n"
    "  echelon render herd.recording --out strip.png --strip 0.5 --start 10 --count 6\n"
    "  echelon render herd.recording --out herd.html --start 10 --seconds 20"
)
PLOT_EXAMPLES = "  echelon plot herd.recording --out herd.png"

RecordingFolder = Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of a recording.")]


class Representation(StrEnum):
    """Of a crowd in a stage."""

    RIG = "rig"
    SKEL = "skel"
    POINTS = "points"


class RepresentationChoice(StrEnum):
    """The same, or what fits the crowd's size."""

    AUTO = "auto"
    RIG = "rig"
    SKEL = "skel"
    POINTS = "points"


RepresentationOption = Annotated[
    RepresentationChoice,
    typer.Option(
        help="rig: a transform a link; skel: UsdSkel, instanced; points: a PointInstancer a link; "
        "auto: rig for up to 150 agents, points for more."
    ),
]


class Camera(StrEnum):
    """Which way to look."""

    FOLLOW = "follow"
    SIDE = "side"
    OVERVIEW = "overview"
    CORRAL = "corral"
    ROADSIDE = "roadside"
    HELICOPTER = "helicopter"


def export(
    recording: RecordingFolder,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.usd", help="The stage to write.")],
    representation: RepresentationOption = RepresentationChoice.AUTO,
    also: Annotated[
        list[Representation] | None,
        typer.Option(help="A further representation to choose from in the stage's variant set; repeatable."),
    ] = None,
    physics: Annotated[
        int | None,
        typer.Option(min=0, metavar="FRAME", help="Write instead a physics layer (UsdPhysics) of this frame."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a USD stage of a recording."""
    from echelon.recording import Recording

    opened = Recording(recording)
    reporter = Reporter(quiet)
    if physics is not None:
        from echelon.export.physics import write_physics

        write_physics(opened, out, physics)
    else:
        make_stage(reporter, opened, out, representation.value, [name.value for name in also or ()])
    reporter.say(f"wrote {out} ({size(out.stat().st_size)})")


def render(
    source: Annotated[Path, typer.Argument(metavar="RECORDING_OR_STAGE", help="A recording, or a stage made of one.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE.mp4|FILE.png|FILE.html", help="A film, a picture or a page.")
    ],
    strip: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="A filmstrip: snapshots so far apart, side by side.")
    ] = None,
    start: Annotated[float | None, typer.Option(metavar="S", help="Time of the first picture.")] = None,
    seconds: Annotated[float | None, typer.Option(metavar="S", help="How long the film or page is.")] = None,
    time_: Annotated[float | None, typer.Option("--time", metavar="S", help="Time of a still.")] = None,
    count: Annotated[int | None, typer.Option(min=1, metavar="N", help="Snapshots of a filmstrip.")] = None,
    fps: Annotated[float | None, typer.Option(metavar="RATE", help="Pictures a second of a film or page.")] = None,
    size_: Annotated[str | None, typer.Option("--size", metavar="WxH", help="Size of a picture [pixels].")] = None,
    camera: Annotated[Camera | None, typer.Option(help="Which way to look at it.")] = None,
    quiet: Quiet = False,
) -> None:
    """Make a film, a still, a filmstrip or a page.

    Of a recording, or of a stage that was made of one. A film of a recording is of its scenario's shot unless the
    options say otherwise, and so is a page: one to send to somebody, who turns and walks around in it with nothing but
    a browser.
    """
    from echelon.export.pictures import render_film, render_still, render_strip
    from echelon.export.renderer import RenderingUnavailable
    from echelon.recording import Recording

    opened = Recording(source) if source.is_dir() or not source.exists() else source
    film = out.suffix.lower() == ".mp4"
    page = out.suffix.lower() == ".html"
    kind = "a film" if film else "a page" if page else "a filmstrip" if strip is not None else "a still"
    given = {
        "start": start, "seconds": seconds, "time": time_, "count": count, "fps": fps,
        "size": None if size_ is None else _parsed_size(size_), "camera": None if camera is None else camera.value,
    }  # fmt: skip
    options = {name: value for name, value in given.items() if value is not None}
    unfit = set(options) - _PICTURE_OPTIONS[kind]
    if strip is not None and (film or page):
        raise InputError(f"--strip: {out} is {kind}; a filmstrip is a .png")
    if unfit:
        raise InputError(f"--{min(unfit)}: not for {kind}, as {out} is to be")
    if page and not isinstance(opened, Recording):
        raise InputError(f"{source}: a page is made of a recording, not of a stage")
    if (film or page) and isinstance(opened, Recording):
        shot = {name: value for name, value in shot_options(opened).items() if name in _PICTURE_OPTIONS[kind]}
        if start is not None or seconds is not None:  # another part of the run
            del shot["start"], shot["seconds"]
        options = shot | options
    reporter = Reporter(quiet)
    if page and isinstance(opened, Recording):
        make_page(reporter, opened, out, **options)
        return
    try:
        with reporter.progress(str(out), "pictures") as progress:
            if film:
                render_film(opened, out, progress=progress, **options)
            elif strip is not None:
                render_strip(opened, out, interval=strip, progress=progress, **options)
            else:
                render_still(opened, out, **options)
    except RenderingUnavailable as error:
        raise Failure(f"{out}: {error}") from None
    reporter.say(f"wrote {out} ({size(out.stat().st_size)})")


_PICTURE_OPTIONS = {
    "a film": {"start", "seconds", "fps", "size", "camera"},
    "a page": {"start", "seconds", "fps"},
    "a filmstrip": {"start", "count", "size", "camera"},
    "a still": {"time", "size", "camera"},
}


def _parsed_size(text: str) -> tuple[int, int]:
    width, times, height = text.lower().partition("x")
    if not times or not width.isdecimal() or not height.isdecimal():
        raise InputError(f"--size {text}: must be WIDTHxHEIGHT in pixels, as in 1280x720")
    return int(width), int(height)


def plot(
    recording: RecordingFolder,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.png|FILE.pdf", help="The page to write.")],
    quiet: Quiet = False,
) -> None:
    """Plot a run on one page.

    Paths from above, speeds, hop phases, distances.
    """
    from echelon.export.plots import plot_run
    from echelon.recording import Recording

    plot_run(Recording(recording), out)
    Reporter(quiet).say(f"wrote {out} ({size(out.stat().st_size)})")
