"""Where a scenario plays: a fenced infield, an open plane, or a road."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np

from echelon.settings import SettingError, Within, adopt, shown

Point = tuple[float, float]


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
class WorldSettings:
    """The ground and what stands on it.

    Attributes:
        ground: "oval" is a fenced infield of two straight sides and two half circles about the origin; "plane" is open;
            "road" is a course with the land around it, and for riders.
        course: For a road, the name of a course that ships, or the path of a course (.toml) or a GPS track (.gpx).
        laps: How often a race goes round the course; 0 takes what the course says.
        half_length: Half the infield's length along x; of a plane, half the side of the square that is drawn [m].
        half_width: Half its width along y, which is the radius of the half circles [m].
        fence_height: [m].
        corral: The pen, if there is one.
    """

    ground: Literal["oval", "plane", "road"] = "oval"
    course: str = ""
    laps: Annotated[int, Within(at_least=0, at_most=1000)] = 0
    half_length: Annotated[float, Within("m", above=0, at_most=1e5)] = 45.0
    half_width: Annotated[float, Within("m", above=0, at_most=1e5)] = 28.0
    fence_height: Annotated[float, Within("m", above=0, at_most=100)] = 1.2
    corral: CorralSettings | None = None

    def __post_init__(self) -> None:
        adopt(self, "world")
        if self.ground == "road":
            if not self.course:
                raise SettingError("world.course", " = '': must name a course, since the ground is a road")
            if self.corral is not None:
                raise SettingError("world.corral", ": must be left out where the ground is a road")
        elif self.course:
            raise SettingError("world.course", f" = {shown(self.course)}: needs world.ground = 'road'")
        if self.ground == "oval" and self.half_length < self.half_width:
            raise SettingError(
                "world.half_length", f" = {self.half_length:g}: must be at least half_width, {self.half_width:g} m"
            )
        if self.corral is not None:
            fences = np.array(self.corral.fences())
            corner = int(np.argmin(self.room(fences)))
            if self.room(fences[corner]) < 0.0:
                where = place_text(fences[corner])
                raise SettingError(
                    "world.corral.center",
                    f" = {list(self.corral.center)}: its corner {where} must be inside the infield",
                )

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
        """Distance from points to the nearest fence of any kind [m]: negative outside the infield.

        Args:
            points: [m], shape [..., 2]; the result has shape [...].
        """
        nearest = self.room(points)
        if self.corral is not None:
            for a, b in pairwise(self.corral.fences()):
                nearest = np.minimum(nearest, _distance_to_segment(np.asarray(points), np.array(a), np.array(b)))
        return nearest


def _distance_to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0.0, 1.0)
    gap = points - a - along[..., None] * (b - a)
    return np.hypot(gap[..., 0], gap[..., 1])


def place_text(point: Iterable[float]) -> str:
    """A place as messages write it."""
    x, y = point
    return f"({x:.3f}, {y:.3f})"
