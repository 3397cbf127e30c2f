"""`echelon course`: a GPS track made into a course, a course in words, a course as a picture."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from echelon.cli.progress import Reporter, size
from echelon.cli.registering import Json, Quiet, command
from echelon.errors import InputError

if TYPE_CHECKING:
    from echelon.terrain.course_facts import CourseFacts

app = typer.Typer(
    name="course",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Courses: import a GPS track, describe one, draw one.",
    epilog="\b\nExamples:\n  echelon course import ride.gpx\n  echelon course plot city-race --out city-race.png",
)

CourseArgument = Annotated[
    str, typer.Argument(metavar="COURSE", help="Name of a course that ships, a .toml file, or a GPS track (.gpx).")
]


@command(
    app,
    "import",
    "  echelon course import ride.gpx\n"
    "  echelon course import ride.gpx --out sunday.toml --width 7 --smooth 8\n"
    "  echelon course import rides.gpx --track 2 --close 0",
)
def import_(
    track: Annotated[Path, typer.Argument(metavar="TRACK.gpx", help="A GPS track with heights.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.toml", help="The course; by default TRACK.toml.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Of the course; by default the file's.")] = "",
    width: Annotated[float, typer.Option(metavar="M", help="Width of the road [m].")] = 6.0,
    smooth: Annotated[
        float, typer.Option(metavar="M", help="No point is moved farther than this, on the map or in height [m].")
    ] = 5.0,
    gap: Annotated[float, typer.Option(metavar="M", help="Greatest distance from point to point [m].")] = 300.0,
    close: Annotated[
        float, typer.Option(metavar="M", help="A track that ends within this of its start is closed [m]; 0: never.")
    ] = 50.0,
    number: Annotated[
        int, typer.Option("--track", min=0, metavar="N", help="Which track of the file, counted from 1.")
    ] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a course of a GPS track.

    Whatever was smoothed, dropped, closed or eased is said, with by how much.
    """
    from echelon.terrain.course import write_course
    from echelon.terrain.track_import import import_track

    target = out if out is not None else Path(track.with_suffix(".toml").name)
    if target.suffix.lower() != ".toml":
        raise InputError(f"{target}: ends in {target.suffix!r}, must end in .toml")
    imported = import_track(track, name=name, width=width, smooth=smooth, gap=gap, close=close, track=number)
    write_course(imported.course, target)
    if as_json:
        print(json.dumps({"course": str(target), "name": imported.course.name, **imported.report.to_dict()}))
        return
    reporter = Reporter(quiet)
    for line in imported.report.lines():
        reporter.say(line)
    reporter.say(f"wrote {target} ({size(target.stat().st_size)})")


@command(app, "describe", "  echelon course describe city-race\n  echelon course describe ride.gpx --json")
def describe(course: CourseArgument, as_json: Json = False) -> None:
    """Describe a course: length, climbing, grades, corners, climbs."""
    from echelon.terrain.course import Course
    from echelon.terrain.course_facts import course_facts

    loaded = Course.load(course)
    facts = course_facts(loaded)
    if as_json:
        head = {"name": loaded.name, "title": loaded.title, "closed": loaded.closed, "width": loaded.width}
        print(json.dumps({**head, "laps": loaded.laps, **facts.to_dict()}))
        return
    print(_in_words(loaded.name, loaded.title, loaded.closed, loaded.width, facts))


def _in_words(name: str, title: str, closed: bool, width: float, facts: CourseFacts) -> str:
    way = "counter-clockwise" if facts.counter_clockwise else "clockwise"
    rows = {
        "length": f"{facts.length:.0f} m, " + (f"closed, {way}" if closed else "open"),
        "width": f"{width:g} m",
        "heights": f"{facts.lowest:.1f} to {facts.highest:.1f} m; {facts.climb:.0f} m up, {facts.descent:.0f} m down",
        "grades": f"{100 * facts.steepest_down:+.2f} % to {100 * facts.steepest_up:+.2f} %",
        "sharpest": f"{facts.sharpest:.1f} m radius in plan, {facts.crest:.0f} m over crests and through dips",
    }
    lines = [f"{name}: {title}" if title else name, *(f"{key:<9} {text}" for key, text in rows.items())]
    if facts.climbs:
        lines += ["", f"{'climb at':>9}  {'length':>8}  {'rise':>6}  {'mean':>6}  {'steepest':>8}"]
    for climb in facts.climbs:
        mean = 100 * climb.rise / climb.length
        place = f"{climb.s / 1000:6.2f} km  {climb.length:6.0f} m  {climb.rise:4.0f} m"
        lines.append(f"{place}  {mean:4.1f} %  {100 * climb.steepest:6.1f} %")
    if facts.corners:
        lines += ["", f"{'corner at':>9}  {'turn':<10}  {'radius':>8}"]
    for corner in facts.corners:
        turn = f"{math.degrees(abs(corner.angle)):.0f}° {'left' if corner.angle > 0.0 else 'right'}"
        lines.append(f"{corner.s / 1000:6.2f} km  {turn:<10}  {corner.radius:6.1f} m")
    return "\n".join(lines)


@command(
    app, "plot", "  echelon course plot city-race --out city-race.png\n  echelon course plot ride.gpx --out ride.pdf"
)
def plot(
    course: CourseArgument,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.png|FILE.pdf|FILE.svg", help="The page to write.")],
    quiet: Quiet = False,
) -> None:
    """Draw a course on one page.

    Plan, profile, grades.
    """
    from echelon.export.course_picture import plot_course
    from echelon.terrain.course import Course

    plot_course(Course.load(course), out)
    Reporter(quiet).say(f"wrote {out} ({size(out.stat().st_size)})")
