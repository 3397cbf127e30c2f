"""A course: the road to ride, the side streets, the land and the scenery around it. A TOML file or these dataclasses.

What is wrong with a course is one `InputError` of one line that names file, key, value and what is allowed, and it
comes when the course is made: a `Course` that exists can be ridden.

x points east, y north, z up; metres. The points of the centreline are given, everything else follows from them: the
spline through them (`Course.centreline`), the surfaces (`Course.surfaces`), the land (`Course.land_height`), the
markings (`Course.lines`), and what stands beside the road (`roadside`).
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy.spatial import KDTree

from echelon.errors import InputError
from echelon.settings import SettingError, Within, adopt, plain, read, shown, suggestion, to_toml
from echelon.terrain.land import LandHeights
from echelon.terrain.markings import road_markings
from echelon.terrain.spline import Centreline
from echelon.terrain.track_road import TrackRoad, road_along

if TYPE_CHECKING:
    from echelon.terrain.road import RoadSurfaces

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]

STEEPEST = 0.35
"""Greatest rise over run of a course: steeper than any street, and than any rider climbs."""

CROSSING_STEP = 0.3
"""Where a road meets itself its heights may differ by this [m]: ground has one height everywhere, and no bridges."""

RECENT_LIMIT = 4
"""Descriptions of courses that are kept in memory with their surfaces, the latest ones; a course has up to two."""

_SAMPLING = 0.5  # [m], of arc length, at which a course is checked
_INNER_ROOM = 0.25  # [m], radius that is left to the inner edge of the verge in the sharpest bend


@dataclass(frozen=True)
class LandSettings:
    """The ground around the road.

    Attributes:
        margin: How far the land reaches beyond the road's box [m].
        hills: How far hills rise and valleys fall away from the road, about [m].
        hill_size: From one hill to the next, about [m].
    """

    margin: Annotated[float, Within("m", at_least=20, at_most=2000)] = 200.0
    hills: Annotated[float, Within("m", at_least=0, at_most=200)] = 8.0
    hill_size: Annotated[float, Within("m", at_least=100, at_most=5000)] = 500.0

    def __post_init__(self) -> None:
        adopt(self, "land")


@dataclass(frozen=True)
class ScenerySettings:
    """What stands beside the road; each spacing is along one side of it, and 0 leaves the kind out.

    Attributes:
        house_spacing: From house to house where the road is built up [m].
        tree_spacing: From tree to tree, about [m].
        lamp_spacing: From light post to light post; they stand on alternate sides [m].
        hydrant_spacing: From hydrant to hydrant [m].
        depth: How far from the road's edge trees grow [m].
    """

    house_spacing: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 36.0
    tree_spacing: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 32.0
    lamp_spacing: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 45.0
    hydrant_spacing: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 150.0
    depth: Annotated[float, Within("m", at_least=5, at_most=200)] = 40.0

    def __post_init__(self) -> None:
        adopt(self, "scenery")
        for kind in ("house", "tree", "lamp", "hydrant"):
            spacing = getattr(self, f"{kind}_spacing")
            if 0.0 < spacing < 4.0:
                raise SettingError(f"scenery.{kind}_spacing", f" = {spacing:g}: must be 0 or at least 4 m")


@dataclass(frozen=True)
class Course:
    """A road to ride.

    Attributes:
        name: Short name: letters, digits, dashes, underscores.
        title: One line.
        description: A paragraph.
        closed: Whether the road comes back to its first point, which is not repeated at the end.
        width: Of the road, from edge to edge [m].
        verge: Of the strip beside each edge that lies level with the road [m].
        laps: How often a race goes round; 1 of an open course.
        seed: Of the hills and of what stands beside the road.
        points: What the centreline goes through (x, y, z), in the order of riding [m].
        side_streets: Other streets, each a list of points (x, y) on the ground [m].
        side_street_width: Of each of them [m].
        land, scenery: See their classes.
    """

    name: str
    title: str = ""
    description: str = ""
    closed: bool = True
    width: Annotated[float, Within("m", at_least=2, at_most=30)] = 8.0
    verge: Annotated[float, Within("m", at_least=0, at_most=20)] = 2.0
    laps: Annotated[int, Within(at_least=1, at_most=1000)] = 1
    seed: Annotated[int, Within(at_least=0, at_most=2**31 - 1)] = 1
    points: Annotated[tuple[Point3, ...], Within("m", at_least=-1e5, at_most=1e5)] = ()
    side_streets: Annotated[tuple[tuple[Point2, ...], ...], Within("m", at_least=-1e5, at_most=1e5)] = ()
    side_street_width: Annotated[float, Within("m", at_least=2, at_most=30)] = 6.0
    land: LandSettings = field(default_factory=LandSettings)
    scenery: ScenerySettings = field(default_factory=ScenerySettings)

    def __post_init__(self) -> None:
        adopt(self, "")
        if not self.name or not self.name.replace("-", "").replace("_", "").isalnum() or not self.name.isascii():
            raise SettingError("name", f" = {shown(self.name)}: must be letters, digits, dashes and underscores")
        if self.laps > 1 and not self.closed:
            raise SettingError("laps", f" = {self.laps}: must be 1, for the course is not closed")
        if self.scenery.depth > self.land.margin - 10.0:
            raise SettingError(
                "scenery.depth",
                f" = {self.scenery.depth:g}: must be 10 m or more within land.margin, {self.land.margin:g} m",
            )
        self._check_points()
        self._check_shape()
        self._check_meetings()
        for index, street in enumerate(self.side_streets):
            self._check_side_street(index, street)

    # ---- what follows from the points --------------------------------------------------------------------------------
    @cached_property
    def centreline(self) -> Centreline:
        """The line in the middle of the road."""
        return Centreline(np.array(self.points, dtype=np.float64), self.closed)

    @property
    def length(self) -> float:
        """Of the centreline, in space, one lap [m]."""
        return self.centreline.length

    @property
    def half_width(self) -> float:
        """From the centreline to an edge of the road [m]."""
        return 0.5 * self.width

    @cached_property
    def land_height(self) -> LandHeights:
        """Height of the land [m] at places (x, y) [m], shape [..., 2]: meets the road along its verge."""
        return LandHeights(
            self.centreline, self.half_width + self.verge, self.land.hills, self.land.hill_size, self.seed
        )

    @cached_property
    def surfaces(self) -> RoadSurfaces:
        """The surface of the road, and that of the land around it."""
        from echelon.terrain.road import RoadSurfaces

        return RoadSurfaces(
            self.centreline, self.half_width, self.verge, self.land_height, land_margin=self.land.margin
        )

    def lines(self) -> dict[str, np.ndarray]:
        """Paint on the road: "edge" and "centre" lines, the "start" and, of an open course, the "finish".

        Returns:
            For each kind its strips as rows (s0, s1, offset0, offset1): from s0 to s1 along the centreline, from
            offset0 to offset1 across it, left positive [m]; shape [strips, 4].
        """
        return road_markings(self.length, self.half_width, self.closed)

    # ---- checks ------------------------------------------------------------------------------------------------------
    def _check_points(self) -> None:
        least = 4 if self.closed else 2
        if len(self.points) < least:
            kind = "a closed course" if self.closed else "an open course"
            raise SettingError("points", f": has {len(self.points)} of them; {kind} must have at least {least}")
        if len(self.points) > 200_000:
            raise SettingError("points", f": has {len(self.points)} of them; must be at most 200000")
        points = np.array(self.points)
        runs = np.hypot(*(np.roll(points, -1, axis=0) - points)[:, :2].T)[: len(points) - (not self.closed)]
        wrong = np.flatnonzero((runs < 0.2) | (runs > 500.0))
        if len(wrong):
            index = int(wrong[0])
            following = (index + 1) % len(points)
            again = "" if following else ", and a closed course must not repeat its first point"
            raise SettingError(
                f"points[{following}]",
                f" = {list(self.points[following])}: lies {runs[index]:.4g} m from points[{index}] on the map; must be "
                f"from 0.2 to 500 m{again}",
            )
        if not 20.0 <= runs.sum() <= 300_000.0:
            raise SettingError("points", f": the road is {runs.sum():.4g} m long; must be from 20 m to 300 km")

    def _check_shape(self) -> None:
        """Neither too steep nor bent so sharply that the inner edge of the verge would fold."""
        line = self.centreline
        s = np.arange(0.0, line.length, _SAMPLING)
        grades = line.grade(s)
        at = int(np.abs(grades).argmax())
        if abs(grades[at]) > STEEPEST:
            raise SettingError(
                self._near(s[at]),
                f": the road is {100 * grades[at]:+.1f} % steep {s[at]:.0f} m along; must be within "
                f"{100 * STEEPEST:g} % up or down",
            )
        least = self.half_width + self.verge + _INNER_ROOM
        bends = np.abs(line.curvature(s))
        at = int(bends.argmax())
        if bends[at] * least > 1.0:
            raise SettingError(
                self._near(s[at]),
                f": the road bends with a radius of {1.0 / bends[at]:.3g} m {s[at]:.0f} m along; must be at least "
                f"{least:g} m, a little more than half the width and the verge",
            )

    def _check_meetings(self) -> None:
        """Where the road meets itself it does so at one height."""
        line = self.centreline
        s = np.arange(0.0, line.length, _SAMPLING)
        places = line.position(s)
        pairs = KDTree(places[:, :2]).query_pairs(1.5 * _SAMPLING, output_type="ndarray")
        first, second = pairs.T
        apart = np.abs(line.difference(s[second], s[first]))
        steps = np.abs(places[second, 2] - places[first, 2])
        meeting = apart > 4.0 * self.width
        if not meeting.any() or steps[meeting].max() <= CROSSING_STEP:
            return
        at = int(np.where(meeting, steps, 0.0).argmax())
        low, high = sorted((float(s[first[at]]), float(s[second[at]])))
        raise SettingError(
            self._near(high),
            f": the road meets itself, {low:.0f} m and {high:.0f} m along, with {steps[at]:.2g} m between its "
            f"heights; must be within {CROSSING_STEP:g} m, for there are no bridges",
        )

    def _check_side_street(self, index: int, street: tuple[Point2, ...]) -> None:
        key = f"side_streets[{index}]"
        if len(street) < 2:
            raise SettingError(key, f": has {len(street)} points; must have at least 2")
        runs = np.hypot(*np.diff(np.array(street), axis=0).T)
        if runs.min() < 0.2:
            at = int(runs.argmin())
            raise SettingError(
                f"{key}[{at + 1}]", f" = {list(street[at + 1])}: must be 0.2 m or more from the one before"
            )

    def _near(self, s: float) -> str:
        """Key of the point that is nearest along the road."""
        return f"points[{int(np.abs(self.centreline.difference(self.centreline.point_s, s)).argmin())}]"

    # ---- files -------------------------------------------------------------------------------------------------------
    @classmethod
    def load(cls, source: str | Path) -> Course:
        """Read a course by the name of one that ships with Echelon, from a .toml file, or from a GPS track (.gpx).

        Along a track a road is laid with the defaults of `echelon.terrain.track_road.road_along`.

        Raises:
            InputError: One line that names file, key, value and what is allowed.
        """
        path = course_path(source)
        if path.suffix.lower() == ".gpx":
            return cls.along(road_along(path))
        data = _parsed(path)
        data.setdefault("name", _name_of(path))
        return cls.from_dict(data, source=_one_line(source))

    @classmethod
    def along(cls, road: TrackRoad, name: str = "") -> Course:
        """The course of a road along a GPS track, named after its file if no name is given.

        Raises:
            InputError: One line that names the track's file and what the course may not be.
        """
        latitude, longitude = road.track.origin
        try:
            return cls(
                name=name or _name_of(road.path),
                title=road.track.title,
                description=f"From a GPS track; the origin is at {latitude:.6f}, {longitude:.6f}.",
                closed=road.track.closed,
                width=road.width,
                verge=road.verge,
                points=tuple((x, y, z) for x, y, z in road.line.points.tolist()),
            )
        except SettingError as error:
            where, bound = _one_line(road.path), f"(smoothed within {road.smooth:g} m)"
            raise InputError(f"{where}: the course made of it: {error} {bound}") from None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: str = "course") -> Course:
        """Build from plain data: parsed TOML or JSON, or what `to_dict` gave.

        Raises:
            InputError: One line that names source, key, value and what is allowed.
        """
        # A recording's course is read to simulate, to export, to draw and to plot: its surfaces are laid once.
        key = json.dumps(data, default=repr)
        if key not in _recent:
            try:
                made = read(cls, data)
            except SettingError as error:
                raise InputError(f"{source}: {error}") from None
            # In full too, as a world has it that is made of this course.
            for known in (key, json.dumps(made.to_dict(), default=repr)):
                while len(_recent) >= RECENT_LIMIT:
                    del _recent[next(iter(_recent))]
                _recent[known] = made
            return made
        return _recent[key]

    def to_dict(self) -> dict[str, Any]:
        """The whole course, defaults included, as plain data; `from_dict` gives it back."""
        return plain(self)

    def to_toml(self) -> str:
        """The whole course as the text of a course file, a point a line."""
        data = self.to_dict()
        lists = {key: data.pop(key) for key in ("points", "side_streets")}
        tables = {key: data.pop(key) for key in tuple(data) if isinstance(data[key], dict)}
        rows = {key: "".join(f"  {row!r},\n" for row in value) for key, value in lists.items()}
        blocks = "".join(f"{key} = [\n{text}]\n" for key, text in rows.items() if text)
        return f"{to_toml(data)}{blocks}\n{to_toml(tables)}"


# ---- files -----------------------------------------------------------------------------------------------------------
_recent: dict[str, Course] = {}


def course_names() -> tuple[str, ...]:
    """Names of the courses that ship with Echelon, in alphabetical order."""
    folder = resources.files("echelon") / "courses"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def course_path(source: str | Path) -> Path:
    """Path of a course file or a track, given as such, or of the course that ships under that name.

    Raises:
        InputError: It is neither the path of a .toml or .gpx file nor a known name.
    """
    name = str(source)
    if name.lower().endswith((".toml", ".gpx")) or "/" in name or "\\" in name:
        return Path(source)
    names = course_names()
    if name not in names:
        hint = suggestion(name, names)
        raise InputError(f"course {shown(name)}: no such course and neither a .toml nor a .gpx file{hint}")
    with resources.as_file(resources.files("echelon") / "courses" / f"{name}.toml") as path:
        return path


def write_course(course: Course, path: str | Path) -> Path:
    """Write a course file (TOML), whole or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    path = Path(path)
    beside = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        beside.write_text(course.to_toml(), encoding="utf-8")
        os.replace(beside, path)
    except OSError as error:
        raise InputError(f"{_one_line(path)}: cannot be written: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
    return path


def _parsed(path: Path) -> dict[str, Any]:
    where = _one_line(path)
    wanted = "must be a course file (TOML)"
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError(f"{where}: no such file; {wanted}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: not UTF-8 at byte {error.start}; {wanted}") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror or error}); {wanted}") from None
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else _one_line(error)
        raise InputError(f"{where}: not valid TOML: {reason}") from None


def _name_of(path: Path) -> str:
    """Of a course, after its file."""
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in path.stem)


def _one_line(value: object) -> str:
    """A path, name or message as text without line breaks or control characters."""
    text = str(value)
    return text if text.isprintable() else shown(text)
