"""A scenario: who stands where, what they want, in which world, for how long. A TOML file or these dataclasses.

Every key of a scenario file is a field below, every table one of the classes; a field's unit is in its docstring.
Whatever is wrong with a scenario is one `InputError` of one line that names file, key, value and what is allowed,
and it comes when the scenario is made: a `Scenario` that exists can be simulated.

World axes are x forward, y left, z up; metres, kilograms, seconds, radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from echelon.errors import InputError
from echelon.scenario.files import copied, one_line, override, parse, scenario_path
from echelon.scenario.starting_places import hexagonal_places, jitter, overlapping_pair
from echelon.settings import SettingError, Within, adopt, plain, read, shown, suggestion, to_toml

Point = tuple[float, float]

CHARACTERS: Mapping[str, str] = {"hopper": "one-legged hopping robot, after Raibert"}
"""The characters that a crowd can be made of, and a line about each."""

_SEED_LIMIT = 2**31 - 1


@dataclass(frozen=True)
class CrowdSettings:
    """Who, and where they start.

    Attributes:
        character: Name of the character; see `CHARACTERS`.
        count: How many.
        start_center: Middle of the region where they start [m].
        start_spacing: Distance between neighbours of the hexagonal pattern they start in [m].
        start_jitter: Each is moved from its place in the pattern by up to this, along x and along y [m].
        positions: Start positions (x, y), one for each, instead of the pattern [m].
        variation: Relative spread of leg stiffness and hop height between individuals.
        in_phase: All start at the same phase of their hop.
    """

    character: str = "hopper"
    count: Annotated[int, Within(at_least=1, at_most=1_000_000)] = 16
    start_center: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (0.0, 0.0)
    start_spacing: Annotated[float, Within("m", above=0, at_most=1e3)] = 2.5
    start_jitter: Annotated[float, Within("m", at_least=0, at_most=1e3)] = 0.3
    positions: Annotated[tuple[Point, ...], Within("m", at_least=-1e5, at_most=1e5)] = ()
    variation: Annotated[float, Within(at_least=0, at_most=0.2)] = 0.06
    in_phase: bool = False

    def __post_init__(self) -> None:
        adopt(self, "crowd")


@dataclass(frozen=True)
class HerdSettings:
    """What each member of the crowd wants, given whom it sees.

    Attributes:
        mode: "herd" keeps together, wanders and flees; "constant" gives everybody `desired_velocity`; "random" changes
            each one's desired velocity by up to `change` every `period`.
        desired_velocity: For mode "constant" (x, y) [m/s].
        change: For mode "random", the greatest change of desired velocity [m/s].
        period: For mode "random", time between changes [s].
        spacing: Distance that neighbours keep from one another [m].
        neighbours: How many of the nearest each one sees at most.
        visibility: How far each one sees [m].
        gain: Speed asked for by a metre of wrong distance to the neighbours [1/s].
        max_speed: Greatest desired speed [m/s].
        max_change: Greatest difference between desired and present velocity: asked for more, a robot falls [m/s].
        flee_distance: The herd flees when the collie is nearer than this to its centroid [m].
        flee_gain: Speed asked for by each metre that one is nearer to the collie than the herd flees to [1/s].
        wander: Whether the undisturbed herd goes from one random goal to the next.
        wander_gain: Speed asked for by a metre between the centroid and the goal [1/s].
        wander_arrive: A new goal is chosen when the centroid is this near to the old one [m].
        wall_distance: Distance kept from fences [m].
        wall_gain: Greatest speed toward a fence, for each metre left before `wall_distance` [1/s]; 0: unseen.
        radius: Radius of a body; two whose discs overlap have collided [m].
        clearance: Gap kept between two bodies [m].
        clearance_gain: Greatest speed of closing in on another, for each metre left before `clearance` [1/s].
        lookahead: Neighbours are reckoned with where they will be so much later [s].
    """

    mode: Literal["herd", "constant", "random"] = "herd"
    desired_velocity: Annotated[Point, Within("m/s", at_least=-20, at_most=20)] = (0.0, 0.0)
    change: Annotated[float, Within("m/s", at_least=0, at_most=20)] = 1.0
    period: Annotated[float, Within("s", above=0, at_most=1e4)] = 2.0
    spacing: Annotated[float, Within("m", above=0, at_most=100)] = 2.5
    neighbours: Annotated[int, Within(at_least=1, at_most=256)] = 8
    visibility: Annotated[float, Within("m", above=0, at_most=1e4)] = 12.0
    gain: Annotated[float, Within("1/s", at_least=0, at_most=100)] = 1.0
    max_speed: Annotated[float, Within("m/s", at_least=0, at_most=20)] = 2.0
    max_change: Annotated[float, Within("m/s", above=0, at_most=100)] = 1.0
    flee_distance: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 15.0
    flee_gain: Annotated[float, Within("1/s", at_least=0, at_most=100)] = 0.5
    wander: bool = True
    wander_gain: Annotated[float, Within("1/s", at_least=0, at_most=100)] = 0.1
    wander_arrive: Annotated[float, Within("m", above=0, at_most=1e3)] = 3.0
    wall_distance: Annotated[float, Within("m", at_least=0, at_most=1e3)] = 1.0
    wall_gain: Annotated[float, Within("1/s", at_least=0, at_most=100)] = 1.0
    radius: Annotated[float, Within("m", at_least=0.01, at_most=10)] = 0.35
    clearance: Annotated[float, Within("m", at_least=0, at_most=100)] = 0.8
    clearance_gain: Annotated[float, Within("1/s", at_least=0, at_most=100)] = 1.0
    lookahead: Annotated[float, Within("s", at_least=0, at_most=10)] = 0.3

    def __post_init__(self) -> None:
        adopt(self, "herd")


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
        ground: "oval" is a fenced infield of two straight sides and two half circles about the origin; "plane" is open.
        half_length: Half the infield's length along x; of a plane, half the side of the square that is drawn [m].
        half_width: Half its width along y, which is the radius of the half circles [m].
        fence_height: [m].
        corral: The pen, if there is one.
    """

    ground: Literal["oval", "plane"] = "oval"
    half_length: Annotated[float, Within("m", above=0, at_most=1e5)] = 45.0
    half_width: Annotated[float, Within("m", above=0, at_most=1e5)] = 28.0
    fence_height: Annotated[float, Within("m", above=0, at_most=100)] = 1.2
    corral: CorralSettings | None = None

    def __post_init__(self) -> None:
        adopt(self, "world")
        if self.ground == "oval" and self.half_length < self.half_width:
            raise SettingError(
                "world.half_length", f" = {self.half_length:g}: must be at least half_width, {self.half_width:g} m"
            )
        if self.corral is not None:
            fences = np.array(self.corral.fences())
            corner = int(np.argmin(self.room(fences)))
            if self.room(fences[corner]) < 0.0:
                raise SettingError(
                    "world.corral.center",
                    f" = {list(self.corral.center)}: its corner {_place(fences[corner])} must be inside the infield",
                )

    def room(self, points: np.ndarray) -> np.ndarray:
        """Distance from points to the fence around the infield [m]: negative outside, infinite on a plane.

        Args:
            points: [m], shape [..., 2]; the result has shape [...].
        """
        points = np.asarray(points, dtype=np.float64)
        if self.ground == "plane":
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


@dataclass(frozen=True)
class CollieSettings:
    """The collie: a rider on a bicycle that goes forward only, and turns widely.

    Attributes:
        driver: "dog" gathers and drives the herd by itself; "waypoints" follows `waypoints`.
        start: Where it starts [m].
        heading: Direction it starts in, from x towards y [rad].
        start_speed: Speed it starts with [m/s].
        waypoints: (time [s], x [m], y [m]), by increasing time: where to be when.
        max_speed: [m/s].
        turning_radius: Radius of its tightest turn [m].
        max_acceleration: Greatest acceleration and braking along its path [m/s^2].
        wheelbase: Distance between its wheels [m].
        steering_rate: How fast its front wheel turns [rad/s].
    """

    driver: Literal["dog", "waypoints"] = "dog"
    start: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (-35.0, 0.0)
    heading: Annotated[float, Within("rad", at_least=-7, at_most=7)] = 0.0
    start_speed: Annotated[float, Within("m/s", at_least=0, at_most=50)] = 0.0
    waypoints: Annotated[tuple[tuple[float, float, float], ...], Within(at_least=-1e5, at_most=1e5)] = ()
    max_speed: Annotated[float, Within("m/s", above=0, at_most=50)] = 6.0
    turning_radius: Annotated[float, Within("m", above=0, at_most=1e3)] = 3.0
    max_acceleration: Annotated[float, Within("m/s^2", above=0, at_most=50)] = 2.0
    wheelbase: Annotated[float, Within("m", above=0, at_most=10)] = 1.1
    steering_rate: Annotated[float, Within("rad/s", above=0, at_most=100)] = 2.0

    def __post_init__(self) -> None:
        adopt(self, "collie")
        if self.driver == "waypoints" and not self.waypoints:
            raise SettingError("collie.waypoints", " = []: must hold at least one (time, x, y) for driver 'waypoints'")
        if self.start_speed > self.max_speed:
            raise SettingError(
                "collie.start_speed", f" = {self.start_speed:g}: must be at most max_speed, {self.max_speed:g} m/s"
            )
        last = -math.inf
        for index, (time, _, _) in enumerate(self.waypoints):
            here = f"collie.waypoints[{index}]"
            if time < 0.0:
                raise SettingError(here, f" = {list(self.waypoints[index])}: its time must be at least 0 s")
            if time <= last:
                raise SettingError(here, f" = {list(self.waypoints[index])}: its time must be later than {last:g} s")
            last = time


@dataclass(frozen=True)
class EngineSettings:
    """How the equations of motion are stepped.

    Attributes:
        substeps: Steps of the dynamics in a frame, a multiple of `tick`; 0 takes as many as the character needs.
        tick: Substeps between two decisions of a controller.
        integrator: "semi-implicit" Euler with implicit servos, or "rk4".
        precision: Of the state.
        lanes: Characters advanced together in one SIMD vector; 0 chooses the host's.
        threads: 0 decides by the amount of work.
    """

    substeps: Annotated[int, Within(at_least=0, at_most=10_000)] = 0
    tick: Annotated[int, Within(at_least=1, at_most=10_000)] = 6
    integrator: Literal["semi-implicit", "rk4"] = "semi-implicit"
    precision: Literal["float32"] = "float32"
    lanes: Literal[0, 1, 4, 8, 16] = 0
    threads: Annotated[int, Within(at_least=0, at_most=1024)] = 0

    def __post_init__(self) -> None:
        adopt(self, "engine")
        if self.substeps % self.tick:
            raise SettingError("engine.tick", f" = {self.tick}: must divide the substeps, {self.substeps}")

    def substeps_at(self, frame_rate: int, steps_per_second: int) -> int:
        """Steps of the dynamics in a frame at so many frames a second, of a character that needs so many steps."""
        return self.substeps or self.tick * -(-steps_per_second // (self.tick * frame_rate))


@dataclass(frozen=True)
class ShotSettings:
    """Which part of a run is filmed, and how.

    Attributes:
        first_frame: First frame of the shot; negative numbers count from the end of the run, -1 is its last frame.
        last_frame: Last frame of the shot, itself included; likewise.
        preroll: Time simulated before frame 0, and not recorded [s].
        camera: "follow" keeps the action framed, "overview" shows the whole field, "corral" the corral.
        size: Width and height of the film, even numbers [pixels].
        film_every: Every how many frames the film takes one.
    """

    first_frame: Annotated[int, Within(at_least=-100_000_000, at_most=100_000_000)] = 0
    last_frame: Annotated[int, Within(at_least=-100_000_000, at_most=100_000_000)] = -1
    preroll: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 0.0
    camera: Literal["follow", "overview", "corral"] = "follow"
    size: Annotated[tuple[int, int], Within("pixels", at_least=16, at_most=8192)] = (640, 360)
    film_every: Annotated[int, Within(at_least=1, at_most=1000)] = 1

    def __post_init__(self) -> None:
        adopt(self, "shot")
        if (self.first_frame < 0) == (self.last_frame < 0) and self.last_frame < self.first_frame:
            raise SettingError(
                "shot.last_frame", f" = {self.last_frame}: must not lie before first_frame, {self.first_frame}"
            )
        if any(length % 2 for length in self.size):
            raise SettingError("shot.size", f" = {list(self.size)}: must be two even numbers, as films ask")

    def frames(self, frame_count: int) -> tuple[int, int]:
        """First and last frame of the shot in a run of so many frames; what lies outside of the run is left out."""
        first, last = (frame if frame >= 0 else frame_count + frame for frame in (self.first_frame, self.last_frame))
        first = min(max(first, 0), frame_count - 1)
        return first, min(max(last, first), frame_count - 1)


@dataclass(frozen=True)
class Scenario:
    """Everything that decides a run. The same scenario gives the same bytes.

    Attributes:
        name: Short name: letters, digits, dashes, underscores.
        title: One line.
        description: A paragraph.
        seconds: How long to simulate, at most [s].
        frame_rate: Frames a second, one of 24, 25, 30, 50, 60.
        seed: Of everything that is random while it runs.
        population_seed: Of where they start and how they differ.
        until: "" runs for all of `seconds`; "penned" stops once the crowd has been penned.
        crowd, herd, world, collie, engine, shot: See their classes. No `collie`: nobody chases anybody.
    """

    name: str
    title: str = ""
    description: str = ""
    seconds: Annotated[float, Within("s", above=0, at_most=1e5)] = 20.0
    frame_rate: Literal[24, 25, 30, 50, 60] = 30
    seed: Annotated[int, Within(at_least=0, at_most=_SEED_LIMIT)] = 1
    population_seed: Annotated[int, Within(at_least=0, at_most=_SEED_LIMIT)] = 1
    until: Literal["", "penned"] = ""
    crowd: CrowdSettings = field(default_factory=CrowdSettings)
    herd: HerdSettings = field(default_factory=HerdSettings)
    world: WorldSettings = field(default_factory=WorldSettings)
    collie: CollieSettings | None = None
    engine: EngineSettings = field(default_factory=EngineSettings)
    shot: ShotSettings = field(default_factory=ShotSettings)

    def __post_init__(self) -> None:
        adopt(self, "")
        if not self.name or not self.name.replace("-", "").replace("_", "").isalnum() or not self.name.isascii():
            raise SettingError("name", f" = {shown(self.name)}: must be letters, digits, dashes and underscores")
        if self.crowd.character not in CHARACTERS:
            hint = suggestion(self.crowd.character, CHARACTERS)
            raise SettingError("crowd.character", f" = {shown(self.crowd.character)}: no such character{hint}")
        if self.step_count < 1:
            raise SettingError("seconds", f" = {self.seconds:g}: must be at least one frame, {1 / self.frame_rate:g} s")
        if self.until == "penned" and self.world.corral is None:
            raise SettingError("until", " = 'penned': needs a world.corral")
        self._check_start()
        self._check_collie()

    # ---- sizes -----------------------------------------------------------------------------------------------------
    @property
    def step_count(self) -> int:
        """Frames to advance, at most: the recording then has one more, the start pose."""
        return round(self.seconds * self.frame_rate)

    def start_positions(self) -> np.ndarray:
        """Where each one starts [m], shape [count, 2].

        The pattern grows from its centre: an agent starts at the same place however many others there are.
        """
        crowd = self.crowd
        if crowd.positions:
            return np.array(crowd.positions, dtype=np.float64)
        places = hexagonal_places(crowd.count) * crowd.start_spacing
        return places + np.array(crowd.start_center) + crowd.start_jitter * jitter(crowd.count, self.population_seed)

    # ---- checks ----------------------------------------------------------------------------------------------------
    def _check_start(self) -> None:
        crowd, least = self.crowd, 2.0 * self.herd.radius
        if crowd.positions and len(crowd.positions) != crowd.count:
            raise SettingError(
                "crowd.count", f" = {crowd.count}: must be the number of positions, {len(crowd.positions)}"
            )
        positions = self.start_positions()
        pair = overlapping_pair(positions, least)
        if pair is not None:
            a, b, distance = pair
            if crowd.positions:
                raise SettingError(
                    f"crowd.positions[{b}]",
                    f" = {list(crowd.positions[b])}: overlaps position {a}, {distance:.3g} m away; must be at least "
                    f"twice the radius, {least:g} m, from every other",
                )
            raise SettingError(
                "crowd.start_spacing",
                f" = {crowd.start_spacing:g}: agents {a} and {b} overlap at the start, {distance:.3g} m apart with a "
                f"jitter of {crowd.start_jitter:g} m; must leave twice the radius, {least:g} m",
            )
        tight = np.flatnonzero(self.world.clearance(positions) < self.herd.radius)
        if len(tight):
            index = int(tight[0])
            where = "outside the infield" if self.world.room(positions[index]) < 0.0 else "across a fence"
            key = f"crowd.positions[{index}]" if crowd.positions else "crowd.start_center"
            value = crowd.positions[index] if crowd.positions else crowd.start_center
            raise SettingError(
                key,
                f" = {list(value)}: agent {index} would start at {_place(positions[index])}, {where}; must be at least "
                f"the radius, {self.herd.radius:g} m, inside every fence",
            )

    def _check_collie(self) -> None:
        if self.collie is None:
            return
        places = [("collie.start", self.collie.start)]
        places += [(f"collie.waypoints[{i}]", (x, y)) for i, (_, x, y) in enumerate(self.collie.waypoints)]
        for key, place in places:
            if self.world.room(np.array(place)) <= 0.0:
                raise SettingError(key, f": {_place(place)} must be inside the infield")

    # ---- files -----------------------------------------------------------------------------------------------------
    @classmethod
    def load(cls, source: str | Path, overrides: Iterable[str] = ()) -> Scenario:
        """Read a scenario by the name of one that ships with Echelon, or from a TOML file.

        Args:
            source: A name ("border-collie"), or the path of a file, which ends in .toml or holds a path separator.
            overrides: "dotted.key=value" each, the value as TOML writes it; a string needs no quotes.

        Raises:
            InputError: One line that names file, key, value and what is allowed.
        """
        path = scenario_path(source)
        data = parse(path)
        data.setdefault("name", "".join(c if c.isascii() and c.isalnum() else "-" for c in path.stem))
        return cls.from_dict(data, source=one_line(source), overrides=overrides)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: str = "scenario", overrides: Iterable[str] = ()) -> Scenario:
        """Build from plain data: parsed TOML or JSON, or what `to_dict` gave.

        Args:
            data: Tables as mappings, keys as in the file.
            source: Where the data came from, for messages.
            overrides: As in `load`.

        Raises:
            InputError: One line that names source, key, value and what is allowed.
        """
        merged = copied(data)
        keys = [override(merged, text) for text in overrides]
        crowd = merged.get("crowd")
        if isinstance(crowd, dict) and isinstance(crowd.get("positions"), list) and crowd["positions"]:
            crowd.setdefault("count", len(crowd["positions"]))
        try:
            return read(cls, merged)
        except SettingError as error:
            overridden = any(error.key == key or error.key.startswith((f"{key}.", f"{key}[")) for key in keys)
            raise InputError(f"{source}{', overridden' if overridden else ''}: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """The whole scenario, defaults included, as plain data; `from_dict` gives it back."""
        return plain(self)

    def to_toml(self) -> str:
        """The whole scenario, defaults included, as the text of a scenario file."""
        return to_toml(self.to_dict())


def _distance_to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0.0, 1.0)
    gap = points - a - along[..., None] * (b - a)
    return np.hypot(gap[..., 0], gap[..., 1])


def _place(point: Iterable[float]) -> str:
    x, y = point
    return f"({x:.3f}, {y:.3f})"
