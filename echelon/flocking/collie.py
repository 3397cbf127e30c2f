"""The collie: a rider on a bicycle whom the herd flees from, and its driver: the dog, waypoints, or a person."""

# pyright: reportGeneralTypeIssues=false
# Warp turns the structs that stand in annotations here into objects of its own.

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp

from echelon.flocking.bicycle import BODY_RADIUS, Bicycle, BicycleLimits, ride
from echelon.flocking.drivers import DogMind, DogRules, drive_as_dog, drive_by_waypoints
from echelon.flocking.herd import HerdArrays, herd_radius
from echelon.flocking.perception import pen_of
from echelon.flocking.person import no_controls, person_body, ride_on_field
from echelon.scenario import CollieSettings, HerdSettings, WorldSettings
from echelon.terrain.walls import wall_grid

PERSON = (300.0, 85.0, 0.45)
"""Strength [W], mass [kg] and drag area [m^2] of a person on the collie's bicycle."""


@dataclass(frozen=True)
class CollieArrays:
    """What the collie is and does; arrays of one.

    Attributes:
        bicycle: State of the bicycle.
        dog: What the dog has made up its mind about.
        command: Desired speed [m/s] and steering angle, positive to the left [rad].
        controls: What the person on it does, by `person.CONTROLS`.
        user: Place and velocity (x, y [m], vx, vy [m/s]): what the herd sees of it.
        pose: World pose; origin on the ground halfway between the wheels, x forward, y left, z up and leaning.
    """

    bicycle: Bicycle
    dog: DogMind
    command: wp.array[wp.vec2]
    controls: wp.array[wp.float32]
    user: wp.array[wp.vec4]
    pose: wp.array[wp.transform]


class Collie:
    """A bicycle and its driver: the dog, the waypoints, or a person, whose `arrays.controls` are written each frame.

    A driver gives commands and nothing else.

    Attributes:
        arrays: Its state, for the herd and for recordings.
    """

    def __init__(
        self,
        settings: CollieSettings,
        herd: HerdSettings,
        world: WorldSettings,
        agent_count: int,
        *,
        frame_rate: int,
        device: wp.DeviceLike = None,
    ) -> None:
        """Place the collie at its start.

        Args:
            settings: The bicycle and its driver.
            herd: Of those it drives.
            world: Where they are.
            agent_count: How many it drives.
            frame_rate: Frames a second.
            device: Where the arrays live.
        """
        self._device = device
        self._limits = _limits(settings, frame_rate)
        self._rules = _dog_rules(herd, world, agent_count)
        self._pen = pen_of(world)
        self._walls = wall_grid(world, 2.0 * BODY_RADIUS, device)
        self._person = person_body(*PERSON, device) if settings.driver == "person" else None
        self._waypoints: wp.array[wp.vec3] | None = None
        if settings.driver == "waypoints":
            self._waypoints = wp.array(settings.waypoints, dtype=wp.vec3, device=device)
        self.arrays = _arrays(settings, device)

    def enqueue(self, frame: wp.array[wp.int32], herd: HerdArrays) -> None:
        """Launch what takes the collie from this frame to the next; can be captured in a graph.

        Args:
            frame: Number of this frame, shape [1].
            herd: What the herd found out in this frame.
        """
        a = self.arrays
        if self._person is not None:
            inputs = [self._limits, self._person, a.controls, a.bicycle]
            wp.launch(ride_on_field, dim=1, inputs=inputs, outputs=[a.command], device=self._device)
        elif self._waypoints is None:
            inputs = [self._limits, self._rules, self._pen, herd.mind, herd.farthest, a.bicycle, a.dog]
            wp.launch(drive_as_dog, dim=1, inputs=inputs, outputs=[a.command], device=self._device)
        else:
            inputs = [self._limits, self._waypoints, frame, a.bicycle]
            wp.launch(drive_by_waypoints, dim=1, inputs=inputs, outputs=[a.command], device=self._device)
        self.enqueue_ride()

    def enqueue_ride(self) -> None:
        """Launch only the bicycle, which follows `arrays.command` for a frame."""
        a = self.arrays
        inputs = [self._limits, self._walls, a.command, a.bicycle]
        wp.launch(ride, dim=1, inputs=inputs, outputs=[a.user, a.pose], device=self._device)

    def state(self) -> dict[str, np.ndarray]:
        """What the next frame depends on besides its arguments; copies."""
        return {name: array.numpy().copy() for name, array in self._persistent().items()}

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        for name, array in self._persistent().items():
            array.assign(state[name])

    def _persistent(self) -> dict[str, wp.array]:
        bicycle, dog = self.arrays.bicycle, self.arrays.dog
        return {
            "place": bicycle.place,
            "heading": bicycle.heading,
            "speed": bicycle.speed,
            "steering": bicycle.steering,
            "entering": dog.entering,
            "gathering": dog.gathering,
            "flank": dog.flank,
            "command": self.arrays.command,
            "user": self.arrays.user,
            "pose": self.arrays.pose,
        }


def _arrays(settings: CollieSettings, device: wp.DeviceLike) -> CollieArrays:
    x, y = settings.start
    ahead = (math.cos(settings.heading), math.sin(settings.heading))
    velocity = [settings.start_speed * part for part in ahead]
    bicycle = Bicycle()
    bicycle.place = wp.array([(x, y)], dtype=wp.vec2, device=device)
    bicycle.heading = wp.array([settings.heading], dtype=wp.float32, device=device)
    bicycle.speed = wp.array([settings.start_speed], dtype=wp.float32, device=device)
    bicycle.steering = wp.zeros(1, dtype=wp.float32, device=device)
    dog = DogMind()
    dog.entering = wp.zeros(1, dtype=wp.int32, device=device)
    dog.gathering = wp.zeros(1, dtype=wp.int32, device=device)
    dog.flank = wp.zeros(1, dtype=wp.int32, device=device)
    half = 0.5 * settings.heading
    pose = (x, y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
    return CollieArrays(
        bicycle=bicycle,
        dog=dog,
        command=wp.zeros(1, dtype=wp.vec2, device=device),
        controls=no_controls(device),
        user=wp.array([(x, y, *velocity)], dtype=wp.vec4, device=device),
        pose=wp.array([pose], dtype=wp.transform, device=device),
    )


def _limits(settings: CollieSettings, frame_rate: int) -> BicycleLimits:
    limits = BicycleLimits()
    limits.max_speed = settings.max_speed
    limits.max_acceleration = settings.max_acceleration
    limits.max_steering = math.atan(settings.wheelbase / settings.turning_radius)
    limits.steering_rate = settings.steering_rate
    limits.wheelbase = settings.wheelbase
    limits.step = 1.0 / frame_rate
    return limits


def _dog_rules(herd: HerdSettings, world: WorldSettings, agent_count: int) -> DogRules:
    rules = DogRules()
    rules.flee_distance = herd.flee_distance
    rules.herd_radius = herd_radius(herd, agent_count)
    if world.ground == "oval":
        rules.field_straight = world.half_length - world.half_width
        rules.field_radius = world.half_width
    return rules
