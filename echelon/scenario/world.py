"""Where a scenario plays: a fenced infield, an open plane, a mat, or a road."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np

from echelon.scenario.starting_places import jitter
from echelon.settings import SettingError, Within, adopt, shown

Point = tuple[float, float]
Circle = tuple[float, float, float]


@dataclass(frozen=True)
class CorralSettings:
    """A square pen, open in the middle of one side.

    Attributes:
        center: Middle of the square [m].
        size: Length of a side [m].
        opening: Width of the opening [m].
        facing: Direction (x, y) in which the opening looks, along an axis; of length one.
        penned_fraction: The crowd counts as penned when this part of it is inside...
        penned_seconds: ... for so long on end [s].
    """

    center: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (25.0, 0.0)
    size: Annotated[float, Within("m", above=0, at_most=1e4)] = 10.0
    opening: Annotated[float, Within("m", above=0, at_most=1e4)] = 6.0
    facing: Point = (-1.0, 0.0)
    penned_fraction: Annotated[float, Within(above=0, at_most=1)] = 0.75
    penned_seconds: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 10.0

    def __post_init__(self) -> None:
        adopt(self, "world.corral")
        if self.opening > self.size:
            raise SettingError(
                "world.corral.opening", f" = {self.opening:g}: must be at most the size, {self.size:g} m"
            )
        if abs(math.hypot(*self.facing) - 1.0) > 1e-6:
            raise SettingError("world.corral.facing", f" = {list(self.facing)}: must be a direction of length 1")

    def fences(self) -> tuple[Point, ...]:
        """The fence as a polyline from one post of the opening round to the other [m]."""
        (cx, cy), (fx, fy), half, gap = self.center, self.facing, self.size / 2, self.opening / 2
        # (forward, left) of the opening's direction.
        local = [(half, gap), (half, half), (-half, half), (-half, -half), (half, -half), (half, -gap)]
        return tuple((cx + a * fx - b * fy, cy + a * fy + b * fx) for a, b in local)


@dataclass(frozen=True)
class WallSettings:
    """A fence along a polyline.

    Attributes:
        points: Its posts (x, y) in order, at least two [m].
        closed: Whether a last piece joins the last post to the first.
        height: [m].
    """

    points: Annotated[tuple[Point, ...], Within("m", at_least=-1e5, at_most=1e5)]
    closed: bool = False
    height: Annotated[float, Within("m", above=0, at_most=100)] = 1.2

    def __post_init__(self) -> None:
        adopt(self, "world.walls")
        if len(self.points) < 2:
            raise SettingError("world.walls.points", f" = {shown(self.points)}: must hold at least two posts")

    def pieces(self) -> tuple[tuple[Point, Point], ...]:
        """Its straight pieces, each by its two posts [m]."""
        return tuple(pairwise((*self.points, self.points[0]) if self.closed else self.points))


@dataclass(frozen=True)
class GapSettings:
    """A straight wall with an opening in its middle.

    Attributes:
        center: Middle of the opening [m].
        facing: Direction (x, y) that leads through the opening; of length one.
        opening: Width of the opening [m].
        width: Length of the whole wall, opening included [m].
    """

    center: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (20.0, 0.0)
    facing: Point = (1.0, 0.0)
    opening: Annotated[float, Within("m", above=0, at_most=1e4)] = 6.0
    width: Annotated[float, Within("m", above=0, at_most=1e4)] = 60.0

    def __post_init__(self) -> None:
        adopt(self, "world.gap")
        if self.opening >= self.width:
            raise SettingError(
                "world.gap.opening", f" = {self.opening:g}: must be less than the width, {self.width:g} m"
            )
        if abs(math.hypot(*self.facing) - 1.0) > 1e-6:
            raise SettingError("world.gap.facing", f" = {list(self.facing)}: must be a direction of length 1")

    def fences(self) -> tuple[tuple[Point, Point], ...]:
        """The wall on the left of the opening and that on its right, each from the opening outward [m]."""
        (cx, cy), (fx, fy) = self.center, self.facing
        ends = ((side * 0.5 * self.opening, side * 0.5 * self.width) for side in (1.0, -1.0))
        return tuple(((cx - fy * a, cy + fx * a), (cx - fy * b, cy + fx * b)) for a, b in ends)


@dataclass(frozen=True)
class ColumnFieldSettings:
    """Columns strewn over a rectangle: rows, every other one shifted by half a spacing, each column a little displaced.

    Attributes:
        center: Middle of the rectangle [m].
        length: Of the rectangle along x [m].
        width: Of the rectangle along y [m].
        spacing: Distance between rows, and between columns of a row [m].
        jitter: Each column is displaced by up to this, along x and along y [m].
        radius: Of a column [m].
        seed: Of the displacements.
    """

    center: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (30.0, 0.0)
    length: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 20.0
    width: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 40.0
    spacing: Annotated[float, Within("m", above=0, at_most=1e4)] = 6.0
    jitter: Annotated[float, Within("m", at_least=0, at_most=1e3)] = 0.8
    radius: Annotated[float, Within("m", above=0, at_most=100)] = 0.4
    seed: Annotated[int, Within(at_least=0, at_most=2**31 - 1)] = 1

    def __post_init__(self) -> None:
        adopt(self, "world.column_field")
        if 2.0 * (self.radius + self.jitter) >= self.spacing:
            raise SettingError(
                "world.column_field.spacing",
                f" = {self.spacing:g}: must be more than twice the radius and the jitter, "
                f"{2.0 * (self.radius + self.jitter):g} m",
            )
        if self.length * self.width > 10_000.0 * self.spacing**2:
            raise SettingError(
                "world.column_field.spacing", f" = {self.spacing:g}: must leave at most 10000 columns in the rectangle"
            )

    def columns(self) -> np.ndarray:
        """Rows (x, y, radius) [m], shape [columns, 3]."""
        rows = int(self.length / self.spacing + 1e-9) + 1
        places = []
        for row in range(rows):
            shift = 0.5 if row % 2 else 0.0
            reach = int(0.5 * self.width / self.spacing + 1e-9)
            across = np.arange(-reach, reach + 1) + shift
            across = across[np.abs(across) * self.spacing <= 0.5 * self.width + 1e-9]
            x = (row - 0.5 * (rows - 1)) * self.spacing
            places += [(x, y * self.spacing) for y in across]
        middles = np.array(places) + np.array(self.center) + self.jitter * jitter(len(places), self.seed)
        return np.column_stack([middles, np.full(len(middles), self.radius)])


@dataclass(frozen=True)
class PlatformSettings:
    """A platform above water, that divers leap from; the places where they start are of the balls of their feet.

    Attributes:
        height: Of its surface above the water [m].
        heading: Which way one faces who stands at its edge with the back to the water, from x towards y [rad].
        edge: Middle of its edge (x, y) [m].
        length: From the edge to its other end, as it is drawn [m].
        width: As it is drawn [m].
    """

    height: Annotated[float, Within("m", above=0, at_most=100)] = 10.0
    heading: Annotated[float, Within("rad", at_least=-100, at_most=100)] = 0.0
    edge: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (0.0, 0.0)
    length: Annotated[float, Within("m", above=0, at_most=1e3)] = 5.0
    width: Annotated[float, Within("m", above=0, at_most=1e3)] = 2.5

    def __post_init__(self) -> None:
        adopt(self, "world.platform")


@dataclass(frozen=True)
class WorldSettings:
    """The ground and what stands on it.

    Attributes:
        ground: "oval" is a fenced infield of two straight sides and two half circles about the origin; "plane" is open;
            "mat" is open too, with a mat in its middle that is only drawn; "water" is for divers, who stand on
            `platform` and whom the water does not hold; "road" is a course with the land around it,
            and for riders.
        course: For a road, the name of a course that ships, or the path of a course (.toml) or a GPS track (.gpx).
        laps: How often a race goes round the course; 0 takes what the course says.
        half_length: Half the infield's length along x; of a plane, half the side of the square that is drawn [m].
        half_width: Half its width along y, which is the radius of the half circles [m].
        fence_height: [m].
        corral: The pen, if there is one.
        platform: Above water.
        gap: A wall with an opening, if there is one.
        walls: Other fences.
        columns: Round columns (x, y, radius) [m].
        column_field: Columns strewn over a rectangle, if there are any.
        column_height: Of all columns [m].
    """

    ground: Literal["oval", "plane", "mat", "water", "road"] = "oval"
    course: str = ""
    laps: Annotated[int, Within(at_least=0, at_most=1000)] = 0
    half_length: Annotated[float, Within("m", above=0, at_most=1e5)] = 45.0
    half_width: Annotated[float, Within("m", above=0, at_most=1e5)] = 28.0
    fence_height: Annotated[float, Within("m", above=0, at_most=100)] = 1.2
    corral: CorralSettings | None = None
    platform: PlatformSettings | None = None
    gap: GapSettings | None = None
    walls: tuple[WallSettings, ...] = ()
    columns: Annotated[tuple[Circle, ...], Within("m", at_least=-1e5, at_most=1e5)] = ()
    column_field: ColumnFieldSettings | None = None
    column_height: Annotated[float, Within("m", above=0, at_most=100)] = 2.5

    def __post_init__(self) -> None:
        adopt(self, "world")
        if self.ground == "road":
            if not self.course:
                raise SettingError("world.course", " = '': must name a course, since the ground is a road")
            for key in ("corral", "gap", "walls", "columns", "column_field"):
                if getattr(self, key):
                    raise SettingError(f"world.{key}", ": must be left out where the ground is a road")
        elif self.course:
            raise SettingError("world.course", f" = {shown(self.course)}: needs world.ground = 'road'")
        if self.ground == "water" and self.platform is None:
            object.__setattr__(self, "platform", PlatformSettings())
        if self.platform is not None and self.ground != "water":
            raise SettingError("world.platform", ": needs world.ground = 'water'")
        if self.ground == "oval" and self.half_length < self.half_width:
            raise SettingError(
                "world.half_length", f" = {self.half_length:g}: must be at least half_width, {self.half_width:g} m"
            )
        for index, column in enumerate(self.columns):
            if column[2] <= 0.0:
                raise SettingError(f"world.columns[{index}]", f" = {list(column)}: its radius must be above 0 m")
        if self.corral is not None:
            fences = np.array(self.corral.fences())
            corner = int(np.argmin(self.room(fences)))
            if self.room(fences[corner]) < 0.0:
                where = place_text(fences[corner])
                raise SettingError(
                    "world.corral.center",
                    f" = {list(self.corral.center)}: its corner {where} must be inside the infield",
                )

    def all_columns(self) -> np.ndarray:
        """Every column: those listed, then those of the field, as (x, y, radius) [m], shape [columns, 3]."""
        listed = np.array(self.columns, dtype=np.float64).reshape(-1, 3)
        return listed if self.column_field is None else np.vstack([listed, self.column_field.columns()])

    def inner_fences(self) -> tuple[tuple[Point, Point], ...]:
        """The straight pieces of every fence but the infield's, each by its two ends [m]."""
        pieces = [] if self.corral is None else [*pairwise(self.corral.fences())]
        if self.gap is not None:
            pieces += self.gap.fences()
        for wall in self.walls:
            pieces += wall.pieces()
        return tuple(pieces)

    def room(self, points: np.ndarray) -> np.ndarray:
        """Distance from points to the fence around the infield [m]: negative outside, infinite on a plane.

        Args:
            points: [m], shape [..., 2]; the result has shape [...].
        """
        points = np.asarray(points, dtype=np.float64)
        if self.ground != "oval":
            return np.full(points.shape[:-1], np.inf)
        straight = self.half_length - self.half_width
        return self.half_width - np.hypot(np.maximum(np.abs(points[..., 0]) - straight, 0.0), points[..., 1])

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """Distance from points to the nearest fence or column [m]: negative outside the infield and within columns.

        Args:
            points: [m], shape [..., 2]; the result has shape [...].
        """
        nearest = self.room(points)
        points = np.asarray(points, dtype=np.float64)
        for a, b in self.inner_fences():
            nearest = np.minimum(nearest, _distance_to_segment(points, np.array(a), np.array(b)))
        for x, y, radius in self.all_columns():
            nearest = np.minimum(nearest, np.hypot(points[..., 0] - x, points[..., 1] - y) - radius)
        return nearest


def _distance_to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0.0, 1.0)
    gap = points - a - along[..., None] * (b - a)
    return np.hypot(gap[..., 0], gap[..., 1])


def place_text(point: Iterable[float]) -> str:
    """A place as messages write it."""
    x, y = point
    return f"({x:.3f}, {y:.3f})"
