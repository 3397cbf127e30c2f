"""A scenario: who stands where, what they want, in which world, for how long. A TOML file or these dataclasses.

Every key of a scenario file is a field below, every table one of the classes; a field's unit is in its docstring.
Whatever is wrong with a scenario is one `InputError` of one line that names file, key, value and what is allowed,
and it comes when the scenario is made: a `Scenario` that exists can be simulated.

World axes are x forward, y left, z up; metres, kilograms, seconds, radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from echelon.errors import InputError
from echelon.scenario.files import copied, one_line, override, parse, scenario_path
from echelon.scenario.herd import CollieSettings, HerdSettings
from echelon.scenario.performance import PERFORMERS, CastSettings, PerformanceSettings
from echelon.scenario.road import ObstacleSettings, PelotonSettings, UserSettings
from echelon.scenario.starting_places import PATTERNS, Pattern, jitter, overlapping_pair
from echelon.scenario.world import Point, WorldSettings, place_text
from echelon.settings import SettingError, Within, adopt, plain, read, shown, suggestion, to_toml

CHARACTERS: Mapping[str, str] = {
    "hopper": "one-legged hopping robot, after Raibert",
    "cyclist": "rider of 12 segments on a racing bicycle",
    "cyclist-1995": "rider of 15 segments on a racing bicycle",
    "point-mass": "puck that takes up any velocity, as far as its acceleration allows",
    **PERFORMERS,
}
"""The characters that a crowd can be made of, and a line about each."""

RIDERS = ("cyclist", "cyclist-1995")
"""Those who ride: on roads, and on fields from a running start; the others live on fields."""

LEAST_RIDING_SPEED = 2.0
"""Slower than this a rider does not start on a field [m/s]."""

_SEED_LIMIT = 2**31 - 1


@dataclass(frozen=True)
class CrowdSettings:
    """Who, and where they start.

    Attributes:
        character: Name of the character; see `CHARACTERS`.
        count: How many.
        start_center: Middle of the region where they start [m].
        start_pattern: What they start in: a "hexagonal" pattern, a "line", "rows" or a "circle"; lines lie along y, and
            turn with `performance.heading`.
        start_rows: Of "rows", how many; 0 for about as many as there are in each.
        start_spacing: Distance between neighbours of the pattern that they start in [m].
        start_jitter: Each is moved from its place in the pattern by up to this, along x and along y [m].
        start_velocity: Everybody's at the start (x, y); riders must have one [m/s].
        positions: Start positions (x, y), one for each, instead of the pattern [m].
        variation: Relative spread between individuals: of a hopper's leg stiffness and hop height, of a rider's power;
            gymnasts go by `performance`.
        in_phase: All start at the same phase of their hop, or of their cranks.
        fallen: What becomes of who falls: they "lie" there, "stand" up where they lie once there is room, or are taken
            away ("remove").
        fallen_seconds: How long they lie before they stand up or are taken away [s].
        contact: Whether they push each other where they touch; they pass through each other otherwise.
        restitution: Speed at which two part who ran into each other, over the speed at which they met.
        friction: Coulomb coefficient of such contacts.
    """

    character: str = "hopper"
    count: Annotated[int, Within(at_least=1, at_most=1_000_000)] = 16
    start_center: Annotated[Point, Within("m", at_least=-1e5, at_most=1e5)] = (0.0, 0.0)
    start_pattern: Pattern = "hexagonal"
    start_rows: Annotated[int, Within(at_least=0, at_most=1_000_000)] = 0
    start_spacing: Annotated[float, Within("m", above=0, at_most=1e3)] = 2.5
    start_jitter: Annotated[float, Within("m", at_least=0, at_most=1e3)] = 0.3
    start_velocity: Annotated[Point, Within("m/s", at_least=-20, at_most=20)] = (0.0, 0.0)
    positions: Annotated[tuple[Point, ...], Within("m", at_least=-1e5, at_most=1e5)] = ()
    variation: Annotated[float, Within(at_least=0, at_most=0.2)] = 0.06
    in_phase: bool = False
    fallen: Literal["lie", "stand", "remove"] = "lie"
    fallen_seconds: Annotated[float, Within("s", at_least=0, at_most=1e5)] = 4.0
    contact: bool = True
    restitution: Annotated[float, Within(at_least=0, at_most=1)] = 0.3
    friction: Annotated[float, Within(at_least=0, at_most=2)] = 0.3

    def __post_init__(self) -> None:
        adopt(self, "crowd")


@dataclass(frozen=True)
class EngineSettings:
    """How the equations of motion are stepped.

    Attributes:
        substeps: Steps of the dynamics in a frame, a multiple of `tick`; 0 takes as many as the character needs.
        tick: Substeps between two decisions of a controller; 0 takes what suits the character.
        integrator: "semi-implicit" Euler with implicit servos, or "rk4".
        precision: Of the state.
        lanes: Characters advanced together in one SIMD vector; 0 chooses the host's.
        threads: 0 decides by the amount of work.
    """

    substeps: Annotated[int, Within(at_least=0, at_most=10_000)] = 0
    tick: Annotated[int, Within(at_least=0, at_most=10_000)] = 0
    integrator: Literal["semi-implicit", "rk4"] = "semi-implicit"
    precision: Literal["float32"] = "float32"
    lanes: Literal[0, 1, 4, 8, 16] = 0
    threads: Annotated[int, Within(at_least=0, at_most=1024)] = 0

    def __post_init__(self) -> None:
        adopt(self, "engine")
        if self.tick and self.substeps % self.tick:
            raise SettingError("engine.tick", f" = {self.tick}: must divide the substeps, {self.substeps}")

    def stride(self, frame_rate: int, steps_per_second: int, steps_per_tick: int) -> tuple[int, int]:
        """How a frame is divided: (substeps, substeps a tick).

        Args:
            frame_rate: Frames a second.
            steps_per_second, steps_per_tick: What the character needs and what suits it.
        """
        if self.substeps:
            # The largest tick that divides the frame and is not longer than what suits the character.
            ticks = (tick for tick in range(min(steps_per_tick, self.substeps), 0, -1) if self.substeps % tick == 0)
            return self.substeps, self.tick or next(ticks)
        tick = self.tick or steps_per_tick
        return tick * -(-steps_per_second // (tick * frame_rate)), tick


@dataclass(frozen=True)
class ShotSettings:
    """Which part of a run is filmed, and how.

    Attributes:
        first_frame: First frame of the shot; negative numbers count from the end of the run, -1 is its last frame.
        last_frame: Last frame of the shot, itself included; likewise.
        preroll: Time simulated before frame 0, and not recorded [s].
        camera: "follow" keeps the action framed, "side" does from the right of those who face a heading, low and
            close, "overview" shows the whole field, "corral" the corral, "roadside"
            stands beside the road and pans, "helicopter" flies along.
        size: Width and height of the film, even numbers [pixels].
        film_every: Every how many frames the film takes one.
    """

    first_frame: Annotated[int, Within(at_least=-100_000_000, at_most=100_000_000)] = 0
    last_frame: Annotated[int, Within(at_least=-100_000_000, at_most=100_000_000)] = -1
    preroll: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 0.0
    camera: Literal["follow", "side", "overview", "corral", "roadside", "helicopter"] = "follow"
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
        until: "" runs for all of `seconds`; "penned" stops once the crowd has been penned, "finished" once everybody
            who still rides has come in, the user too.
        crowd, world, engine, shot: See their classes.
        herd, collie: On a field. No `collie`: nobody chases anybody.
        performance: Of gymnasts. None: they stand.
        peloton, user, obstacles: On a road. No `user`: the crowd rides alone.
    """

    name: str
    title: str = ""
    description: str = ""
    seconds: Annotated[float, Within("s", above=0, at_most=1e5)] = 20.0
    frame_rate: Literal[24, 25, 30, 50, 60] = 30
    seed: Annotated[int, Within(at_least=0, at_most=_SEED_LIMIT)] = 1
    population_seed: Annotated[int, Within(at_least=0, at_most=_SEED_LIMIT)] = 1
    until: Literal["", "penned", "finished"] = ""
    crowd: CrowdSettings = field(default_factory=CrowdSettings)
    herd: HerdSettings = field(default_factory=HerdSettings)
    world: WorldSettings = field(default_factory=WorldSettings)
    collie: CollieSettings | None = None
    performance: PerformanceSettings | None = None
    peloton: PelotonSettings = field(default_factory=PelotonSettings)
    user: UserSettings | None = None
    obstacles: tuple[ObstacleSettings, ...] = ()
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
        if self.on_road:
            self._check_road()
        else:
            self._check_field()
            self._check_performance()
            self._check_start()
            self._check_collie()

    # ---- sizes -----------------------------------------------------------------------------------------------------
    @property
    def step_count(self) -> int:
        """Frames to advance, at most: the recording then has one more, the start pose."""
        return round(self.seconds * self.frame_rate)

    def start_positions(self) -> np.ndarray:
        """Where each one starts [m], shape [count, 2].

        A hexagonal pattern or a line grows from its centre: an agent starts at the same place however many others
        there are.
        """
        crowd = self.crowd
        if crowd.positions:
            return np.array(crowd.positions, dtype=np.float64)
        places = PATTERNS[crowd.start_pattern](crowd.count, crowd.start_rows) * crowd.start_spacing
        if crowd.start_pattern != "hexagonal" and self.performance is not None:
            c, s = math.cos(self.performance.heading), math.sin(self.performance.heading)
            places = places @ np.array([[c, s], [-s, c]])
        return places + np.array(crowd.start_center) + crowd.start_jitter * jitter(crowd.count, self.population_seed)

    @property
    def on_road(self) -> bool:
        """Whether it plays on a road."""
        return self.world.ground == "road"

    @property
    def performs(self) -> bool:
        """Whether the crowd are gymnasts, who follow scripts."""
        return self.crowd.character in PERFORMERS

    # ---- checks ----------------------------------------------------------------------------------------------------
    def _check_road(self) -> None:
        if self.crowd.character not in RIDERS:
            raise SettingError(
                "crowd.character",
                f" = {shown(self.crowd.character)}: must be one of {', '.join(RIDERS)} where world.ground is 'road'",
            )
        if self.crowd.positions:
            raise SettingError("crowd.positions", ": must be left out on a road, where peloton.* says who starts where")
        if self.collie is not None:
            raise SettingError("collie", ": must be left out on a road; who rides along is `user`")

    def _check_field(self) -> None:
        if self.crowd.character in RIDERS and math.hypot(*self.crowd.start_velocity) < LEAST_RIDING_SPEED:
            raise SettingError(
                "crowd.start_velocity",
                f" = {list(self.crowd.start_velocity)}: must be at least {LEAST_RIDING_SPEED:g} m/s for a "
                f"{self.crowd.character} where world.ground is {shown(self.world.ground)}, not 'road'",
            )
        if self.until == "finished":
            raise SettingError("until", " = 'finished': needs world.ground = 'road'")
        for key, value in (("user", self.user), ("obstacles", self.obstacles or None)):
            if value is not None:
                raise SettingError(key, ": needs world.ground = 'road'")

    def _check_performance(self) -> None:
        allowed = ", ".join(PERFORMERS)
        if self.world.platform is not None and not self.performs:
            raise SettingError("world.ground", f" = 'water': needs crowd.character to be one of {allowed}")
        if not self.performs:
            if self.performance is not None:
                raise SettingError("performance", f": needs crowd.character to be one of {allowed}")
            return
        if self.collie is not None:
            raise SettingError("collie", f": must be left out for a {self.crowd.character}")
        if self.until:
            raise SettingError("until", f" = {shown(self.until)}: must be left out for a {self.crowd.character}")
        if self.crowd.fallen != "lie":
            raise SettingError(
                "crowd.fallen", f" = {shown(self.crowd.fallen)}: must be 'lie' for a {self.crowd.character}"
            )
        if self.crowd.start_velocity != (0.0, 0.0):
            raise SettingError(
                "crowd.start_velocity",
                f" = {list(self.crowd.start_velocity)}: must be left out for a {self.crowd.character}",
            )

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
            if index and not crowd.positions:
                raise SettingError(
                    "crowd.count",
                    f" = {crowd.count}: agent {index} would start at {place_text(positions[index])}, {where}; about "
                    f"{index} fit: {self._more_room(positions)}",
                )
            key = f"crowd.positions[{index}]" if crowd.positions else "crowd.start_center"
            value = crowd.positions[index] if crowd.positions else crowd.start_center
            raise SettingError(
                key,
                f" = {list(value)}: agent {index} would start at {place_text(positions[index])}, {where}; must be at "
                f"least the radius, {self.herd.radius:g} m, inside every fence",
            )

    def _more_room(self, positions: np.ndarray) -> str:
        """What to set so that everybody fits into the field who would start at these places, in the pattern."""
        world = self.world
        text = f"lower crowd.count or crowd.start_spacing ({self.crowd.start_spacing:g} m)"
        wide = math.ceil(float(np.hypot(*positions.T).max()) + self.herd.radius)
        keys = "world.half_width" if world.half_length >= wide else "world.half_width and world.half_length"
        larger = replace(world, half_width=max(wide, world.half_width), half_length=max(wide, world.half_length))
        if larger.clearance(positions).min() >= self.herd.radius:
            return f"{text}, or raise {keys} to {wide} m"
        return f"{text}, or move crowd.start_center or the fences and columns that are in the way (world.*)"

    def _check_collie(self) -> None:
        if self.collie is None:
            return
        places = [("collie.start", self.collie.start)]
        places += [(f"collie.waypoints[{i}]", (x, y)) for i, (_, x, y) in enumerate(self.collie.waypoints)]
        for key, place in places:
            if self.world.room(np.array(place)) <= 0.0:
                raise SettingError(key, f": {place_text(place)} must be inside the infield")

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
        _find_course(data, path.parent)
        _find_maneuvers(data, path.parent)
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
        _take_character_of_cast(merged)
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


def _find_course(data: dict[str, Any], folder: Path) -> None:
    """A course that is a file is looked for beside the scenario's, if it is not where the command was called."""
    world = data.get("world")
    course = world.get("course") if isinstance(world, dict) else None
    if isinstance(course, str) and Path(course).suffix in (".toml", ".gpx") and not Path(course).exists():
        beside = folder / course
        if isinstance(world, dict) and beside.exists():
            world["course"] = str(beside)


def _find_maneuvers(data: dict[str, Any], folder: Path) -> None:
    """Maneuvers that are files are looked for likewise."""

    def found(name: Any) -> Any:
        if isinstance(name, list):
            return [found(entry) for entry in name]
        if isinstance(name, str) and name.endswith(".toml") and not Path(name).exists() and (folder / name).exists():
            return str(folder / name)
        return name

    performance = data.get("performance")
    if not isinstance(performance, dict):
        return
    casts = performance.get("casts")
    for table in (performance, *(casts if isinstance(casts, list) else ())):
        for key in ("maneuver", "waiting"):
            if isinstance(table, dict) and key in table:
                table[key] = found(table[key])


def _take_character_of_cast(data: dict[str, Any]) -> None:
    """The crowd's character is that of its first cast, if it has casts and names none."""
    performance = data.get("performance")
    casts = performance.get("casts") if isinstance(performance, dict) else None
    if not isinstance(casts, list) or not casts or not isinstance(casts[0], dict):
        return
    crowd = data.setdefault("crowd", {})
    if isinstance(crowd, dict):
        crowd.setdefault("character", casts[0].get("character", CastSettings.character))
