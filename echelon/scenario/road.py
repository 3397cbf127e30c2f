"""A ride on a road: how a peloton rides, who rides with it, and what stands or runs in its way.

Distances along a road are arc lengths of its centreline from its start; offsets are from the centreline, positive to
the left. Otherwise as in `echelon.scenario.scenario`: metres, seconds, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from echelon.settings import SettingError, Within, adopt

OBSTACLE_SIZES = {"jogger": (0.6, 0.6), "car": (4.4, 1.8), "barrier": (6.0, 1.5)}
"""Length along the road and width across it of each kind of obstacle, where a scenario does not say [m]."""


@dataclass(frozen=True)
class TacticsSettings:
    """What riders decide to do beside riding along: discrete choices, each kept for a while.

    Attributes:
        pull_seconds: Who has ridden at the front for about this long rotates off it, half as much again at most [s].
        drop_speed: Who rotates off rides so much slower than those around, until all have passed [m/s].
        attacks: How often each rider breaks away, on average, in an hour of riding near the front [1/h].
        attack_speed: Who breaks away rides so much faster than otherwise... [m/s]
        attack_seconds: ... for so long [s].
        chase_gap: Who has nobody nearer ahead than this, but somebody in sight, closes the gap... [m]
        closed_gap: ... until it is no more than this [m].
        chase_speed: Who closes a gap rides so much faster than otherwise [m/s].
        dwell_seconds: No choice is changed before it is so old [s].
        rest_seconds: Between two attacks, and between two chases, of one rider [s].
    """

    pull_seconds: Annotated[float, Within("s", at_least=1, at_most=1e4)] = 40.0
    drop_speed: Annotated[float, Within("m/s", above=0, at_most=5)] = 1.0
    attacks: Annotated[float, Within("1/h", at_least=0, at_most=3600)] = 2.0
    attack_speed: Annotated[float, Within("m/s", at_least=0, at_most=5)] = 2.0
    attack_seconds: Annotated[float, Within("s", at_least=1, at_most=1e4)] = 30.0
    chase_gap: Annotated[float, Within("m", above=0, at_most=1e3)] = 8.0
    closed_gap: Annotated[float, Within("m", above=0, at_most=1e3)] = 3.0
    chase_speed: Annotated[float, Within("m/s", at_least=0, at_most=5)] = 1.0
    dwell_seconds: Annotated[float, Within("s", at_least=0.5, at_most=1e3)] = 5.0
    rest_seconds: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 60.0

    def __post_init__(self) -> None:
        adopt(self, "peloton.tactics")
        if self.closed_gap >= self.chase_gap:
            raise SettingError(
                "peloton.tactics.closed_gap", f" = {self.closed_gap:g}: must be below chase_gap, {self.chase_gap:g} m"
            )


@dataclass(frozen=True)
class PelotonSettings:
    """How riders ride on a road, given whom and what they see.

    Attributes:
        mode: "pursuit" steers for a point a short way ahead at the rider's own offset, and turns it into a curvature;
            "lookahead" is the papers': the heading to a point `lookahead` ahead.
        training_speed: Speed at which a rider rides alone, on average over riders [m/s].
        training_spread: Riders' training speeds differ by up to this from the average [m/s].
        distance_gain: k_d of the papers: speed asked for by a metre to where the group is [1/s].
        velocity_gain: k_v of the papers: the same for the rate at which that changes.
        grouping_limit: Speed asked for by the group, at most [m/s].
        gathering: The group draws a rider sideways from the own offset, at most so far [m].
        visibility: How far each one sees other riders [m].
        neighbours: How many of the nearest each one sees at most.
        sight: How far each one sees obstacles on the road [m].
        pursuit_distance: The point pursued is so far ahead [m]...
        pursuit_time: ... or as far as one rides in so long, whichever is more [s].
        lookahead: Distance of the papers' point [m].
        corner_lean: Lean that a rider allows for in a corner [rad].
        corner_braking: Braking before a corner [m/s^2].
        braking: Braking behind others and before obstacles [m/s^2].
        eagerness: A rider never asks for more than the present speed and this [m/s].
        slowest: No rider is ever asked to ride slower: a bicycle would fall [m/s].
        edge_margin: Distance that wheels keep from the road's edge [m].
        side_clearance: Gap kept to those beside [m].
        obstacle_clearance: Gap kept to obstacles when passing, where there is room [m].
        gap: Gap kept to the wheel ahead [m]...
        headway: ... and as much more as one rides in so long [s].
        sideways_speed: Greatest speed of moving across the road [m/s].
        start_distance: Where the front row's rear wheels start, the others behind; on an open road at least so far
            from its start that the last row is on it [m].
        columns: Riders abreast at the start, if the road is wide enough.
        lateral_spacing: Between riders abreast at the start, and so between the offsets that riders keep [m].
        row_spacing: From row to row at the start [m].
        start_speed: [m/s].
        drafting: Whether the air a rider meets depends on who is ahead.
        tactics: None: everybody rides along.
        body_length: Of bicycle and rider [m].
        body_behind: Part of that length behind the rear wheel's contact with the ground [m].
        body_half_width: [m].
        wheelbase: [m].
    """

    mode: Literal["pursuit", "lookahead"] = "pursuit"
    training_speed: Annotated[float, Within("m/s", at_least=2, at_most=20)] = 11.0
    training_spread: Annotated[float, Within("m/s", at_least=0, at_most=5)] = 0.4
    distance_gain: Annotated[float, Within("1/s", at_least=0, at_most=10)] = 0.1
    velocity_gain: Annotated[float, Within(at_least=0, at_most=1)] = 0.01
    grouping_limit: Annotated[float, Within("m/s", at_least=0, at_most=10)] = 1.5
    gathering: Annotated[float, Within("m", at_least=0, at_most=5)] = 0.2
    visibility: Annotated[float, Within("m", at_least=5, at_most=1e3)] = 80.0
    neighbours: Annotated[int, Within(at_least=1, at_most=256)] = 16
    sight: Annotated[float, Within("m", at_least=10, at_most=1e3)] = 100.0
    pursuit_distance: Annotated[float, Within("m", at_least=2, at_most=100)] = 8.0
    pursuit_time: Annotated[float, Within("s", at_least=0, at_most=10)] = 1.5
    lookahead: Annotated[float, Within("m", at_least=2, at_most=200)] = 30.0
    corner_lean: Annotated[float, Within("rad", at_least=0.05, at_most=0.7)] = 0.349
    corner_braking: Annotated[float, Within("m/s^2", at_least=0.05, at_most=5)] = 0.4
    braking: Annotated[float, Within("m/s^2", at_least=0.1, at_most=5)] = 0.8
    eagerness: Annotated[float, Within("m/s", at_least=0.2, at_most=20)] = 1.0
    slowest: Annotated[float, Within("m/s", at_least=0, at_most=5)] = 2.0
    edge_margin: Annotated[float, Within("m", at_least=0, at_most=5)] = 0.9
    side_clearance: Annotated[float, Within("m", at_least=0, at_most=5)] = 0.4
    obstacle_clearance: Annotated[float, Within("m", at_least=0, at_most=5)] = 0.7
    gap: Annotated[float, Within("m", at_least=0.1, at_most=50)] = 0.9
    headway: Annotated[float, Within("s", at_least=0, at_most=5)] = 0.05
    sideways_speed: Annotated[float, Within("m/s", above=0, at_most=5)] = 0.6
    start_distance: Annotated[float, Within("m", at_least=-1e4, at_most=1e6)] = 0.0
    columns: Annotated[int, Within(at_least=1, at_most=100)] = 4
    lateral_spacing: Annotated[float, Within("m", above=0, at_most=20)] = 1.2
    row_spacing: Annotated[float, Within("m", above=0, at_most=100)] = 3.2
    start_speed: Annotated[float, Within("m/s", at_least=0, at_most=20)] = 6.0
    drafting: bool = False
    tactics: TacticsSettings | None = None
    body_length: Annotated[float, Within("m", above=0, at_most=10)] = 1.7
    body_behind: Annotated[float, Within("m", at_least=0, at_most=10)] = 0.35
    body_half_width: Annotated[float, Within("m", above=0, at_most=2)] = 0.25
    wheelbase: Annotated[float, Within("m", above=0, at_most=5)] = 1.0

    def __post_init__(self) -> None:
        adopt(self, "peloton")
        if self.training_spread >= self.training_speed:
            raise SettingError(
                "peloton.training_spread",
                f" = {self.training_spread:g}: must be below training_speed, {self.training_speed:g} m/s",
            )
        if self.start_speed < self.slowest:
            raise SettingError(
                "peloton.start_speed", f" = {self.start_speed:g}: must be at least slowest, {self.slowest:g} m/s"
            )
        _at_least_a_body("lateral_spacing", self.lateral_spacing, 2.0 * self.body_half_width)
        _at_least_a_body("row_spacing", self.row_spacing, self.body_length)
        if self.body_length < 2.0 * self.body_half_width:
            raise SettingError(
                "peloton.body_length",
                f" = {self.body_length:g}: must be at least the width, {2.0 * self.body_half_width:g} m",
            )


@dataclass(frozen=True)
class UserSettings:
    """The rider whom a user would be: here one who follows a script, on a simple bicycle that cannot reverse.

    The user sees and avoids others like everybody else; only speed and offset come from the script. Between two keys
    both change evenly, before the first and after the last they stay.

    Attributes:
        by: What the keys count: "time" since frame 0 [s], or "distance" ridden along the road from its start
            [m]; "person" is for `echelon play`, and of the keys only the first counts, for the start.
        keys: (time or distance, speed [m/s], offset [m]), by increasing time or distance.
        ahead: Starts so far ahead of the front row, behind it where negative [m].
        power: Sustained; on climbs this is what is left to ride with [W].
        mass: With the bicycle [kg].
        drag_area: Drag coefficient times frontal area [m^2].
        max_acceleration: Along the road; brakes half as hard again [m/s^2].
        wheelbase: [m].
        turning_radius: Of the tightest turn [m].
        steering_rate: How fast the front wheel turns [rad/s].
    """

    by: Literal["time", "distance", "person"] = "time"
    keys: Annotated[tuple[tuple[float, float, float], ...], Within(at_least=-1e6, at_most=1e6)] = ((0.0, 11.0, 0.0),)
    ahead: Annotated[float, Within("m", at_least=-1e4, at_most=1e4)] = 8.0
    power: Annotated[float, Within("W", above=0, at_most=5000)] = 360.0
    mass: Annotated[float, Within("kg", above=0, at_most=1000)] = 88.0
    drag_area: Annotated[float, Within("m^2", at_least=0, at_most=10)] = 0.29
    max_acceleration: Annotated[float, Within("m/s^2", above=0, at_most=50)] = 1.0
    wheelbase: Annotated[float, Within("m", above=0, at_most=10)] = 1.0
    turning_radius: Annotated[float, Within("m", above=0, at_most=1e3)] = 3.0
    steering_rate: Annotated[float, Within("rad/s", above=0, at_most=100)] = 1.0

    def __post_init__(self) -> None:
        adopt(self, "user")
        if not self.keys:
            raise SettingError("user.keys", " = []: must hold at least one (time or distance, speed, offset)")
        last = -math.inf
        for index, (when, speed, _) in enumerate(self.keys):
            here = f"user.keys[{index}]"
            if when <= last:
                raise SettingError(here, f" = {list(self.keys[index])}: its {self.by} must be more than {last:g}")
            if not 0.0 < speed <= 20.0:
                raise SettingError(here, f" = {list(self.keys[index])}: its speed must be above 0 and at most 20 m/s")
            last = when


@dataclass(frozen=True)
class ObstacleSettings:
    """Something on the road, with its sides along the road.

    Attributes:
        kind: "jogger" moves along the road, "car" is parked, "barrier" narrows the road.
        distance: Of its middle along the road; of a jogger's at frame 0 [m].
        offset: Of its middle [m].
        length: Along the road; 0 takes that of `OBSTACLE_SIZES` [m].
        width: Across the road; 0 likewise [m].
        speed: Of a jogger along the road, against the riders where negative [m/s].
    """

    kind: Literal["jogger", "car", "barrier"]
    distance: Annotated[float, Within("m", at_least=0, at_most=1e6)]
    offset: Annotated[float, Within("m", at_least=-100, at_most=100)] = 0.0
    length: Annotated[float, Within("m", at_least=0, at_most=200)] = 0.0
    width: Annotated[float, Within("m", at_least=0, at_most=50)] = 0.0
    speed: Annotated[float, Within("m/s", at_least=-10, at_most=10)] = 0.0

    def __post_init__(self) -> None:
        adopt(self, "obstacles")
        if self.speed != 0.0 and self.kind != "jogger":
            raise SettingError("obstacles.speed", f" = {self.speed:g}: must be 0 for a {self.kind}")

    @property
    def size(self) -> tuple[float, float]:
        """Length along the road and width across it [m]."""
        length, width = OBSTACLE_SIZES[self.kind]
        return self.length or length, self.width or width


def _at_least_a_body(name: str, value: float, least: float) -> None:
    if value < least:
        raise SettingError(f"peloton.{name}", f" = {value:g}: riders would overlap; must be at least {least:g} m")
