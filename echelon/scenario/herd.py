"""A herd on a field, and the collie that drives it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from echelon.scenario.world import Point
from echelon.settings import SettingError, Within, adopt


@dataclass(frozen=True)
class HerdSettings:
    """What each member of the crowd wants, given whom it sees.

    Attributes:
        mode: "herd" keeps together, wanders and flees; "march" keeps together and goes where `desired_velocity` and
            `turns` say, by `law`; "constant" gives everybody `desired_velocity`; "random" changes each one's desired
            velocity by up to `change` every `period`.
        desired_velocity: For modes "constant" and "march" (x, y) [m/s].
        turns: For mode "march", (time [s], x, y [m/s]) by increasing time: desired velocities from then on.
        law: For mode "march", how each one keeps its distance: "brogan-hodgins" as published, by desired positions
            alone; "approach" also limits how fast one may come nearer to what is ahead; "foresight" also looks for the
            velocity whose consequences are best, for those who can neither stop nor step aside; "alone" does not see
            others.
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
        sight: For mode "march", how far ahead fences and columns across the way are seen [m].
        horizon: For law "foresight", how far ahead consequences are reckoned [s].
        response: For law "foresight", time until a body begins to take up a new velocity [s].
        acceleration: For law "foresight", at which it then changes its velocity [m/s^2].
        slowest: For law "foresight", the least speed that is chosen [m/s].
        nose: For law "foresight", how far a body reaches ahead of its place, on its way past fences and columns [m].
    """

    mode: Literal["herd", "march", "constant", "random"] = "herd"
    desired_velocity: Annotated[Point, Within("m/s", at_least=-20, at_most=20)] = (0.0, 0.0)
    turns: Annotated[tuple[tuple[float, float, float], ...], Within(at_least=-1e5, at_most=1e5)] = ()
    law: Literal["brogan-hodgins", "approach", "foresight", "alone"] = "approach"
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
    sight: Annotated[float, Within("m", at_least=0, at_most=1e4)] = 10.0
    horizon: Annotated[float, Within("s", above=0, at_most=60)] = 3.0
    response: Annotated[float, Within("s", at_least=0, at_most=10)] = 0.3
    acceleration: Annotated[float, Within("m/s^2", above=0, at_most=100)] = 3.0
    slowest: Annotated[float, Within("m/s", at_least=0, at_most=20)] = 0.0
    nose: Annotated[float, Within("m", at_least=0, at_most=10)] = 0.0

    def __post_init__(self) -> None:
        adopt(self, "herd")
        last = -math.inf
        for index, turn in enumerate(self.turns):
            if turn[0] <= last:
                raise SettingError(f"herd.turns[{index}]", f" = {list(turn)}: its time must be later than {last:g} s")
            last = turn[0]


@dataclass(frozen=True)
class CollieSettings:
    """The collie: a rider on a bicycle that goes forward only, and turns widely.

    Attributes:
        driver: "dog" gathers and drives the herd by itself; "waypoints" follows `waypoints`;
            "person" is for `echelon play`.
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

    driver: Literal["dog", "waypoints", "person"] = "dog"
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
