"""The user's bicycle on a road: simple dynamics that follow the user's plan and a speed.

It is the collie's bicycle (`echelon.flocking.bicycle`): limited acceleration, steering and lean, and no reverse. Added
here is that it climbs no faster than its rider's power allows, and that its pose lies on the road.

The plan is an offset and its rate of change. The rear wheel is brought there like a critically damped spring on top of
the road's own bend: with y the offset, psi the angle between bicycle and road and v the speed,

    curvature = bend + (omega / v)^2 (lane - y) - 2 (omega / v) (psi - lane_rate / v)

Steering for a point ahead would cut corners by half a metre, into whoever rides beside.

Where a person rides (`person`), there is neither plan nor wish: pedals, brake and handlebars do it all.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import numpy as np
import warp as wp

from echelon.flocking.bicycle import BRAKING, GRAVITY, Bicycle, BicycleLimits, angle_from, direction, ride
from echelon.flocking.person import BRAKES, no_controls, person_body, ride_on_road
from echelon.flocking.road_riders import RoadRiders, RoadRules, level_tangent
from echelon.scenario import WorldSettings
from echelon.scenario.road import UserSettings
from echelon.terrain.spline_kernels import (
    CentrelineData,
    centreline_closest,
    centreline_curvature,
    centreline_grade,
    centreline_position,
)
from echelon.terrain.walls import wall_grid

wp.set_module_options({"enable_backward": False})

MAX_SPEED = 20.0  # [m/s]
AIR_DENSITY = wp.constant(1.2)  # [kg/m^3]
ROLLING = wp.constant(0.005)  # rolling resistance over weight
PATH_RATE = wp.constant(1.5)  # [rad/s]; omega above
STEERED_SPEED = wp.constant(2.0)  # [m/s]; slower than this it steers as if it rode at this speed
STEERING_TIME = wp.constant(0.1)  # [s]; the bend so far ahead is steered for: the front wheel takes a while to turn
SHARPEST = wp.constant(0.2)  # of the centreline's radius, that of a line inside of a bend, at least


@wp.struct
class UserBody:
    """What the user's power has to overcome; units as in `UserSettings`."""

    power: wp.float32
    mass: wp.float32
    drag_area: wp.float32


@wp.func
def climbing_speed(grade: float, body: UserBody) -> float:
    """The speed at which a power is all used up on a grade [m/s]."""
    slow = wp.float32(0.0)
    fast = wp.float32(MAX_SPEED)
    pull = body.mass * GRAVITY * (grade + ROLLING)
    for _ in range(16):
        speed = 0.5 * (slow + fast)
        if speed * (pull + 0.5 * AIR_DENSITY * body.drag_area * speed * speed) > body.power:
            fast = speed
        else:
            slow = speed
    return slow


@wp.func
def steering_along(rider: int, riders: RoadRiders, path: CentrelineData, limits: BicycleLimits) -> float:
    """The steering angle that brings a bicycle's rear wheel onto its plan, and keeps it there [rad]."""
    speed = wp.max(riders.speed[rider], STEERED_SPEED)
    s = riders.s[rider]
    offset = riders.offset[rider]
    bend = centreline_curvature(path, s + STEERING_TIME * riders.speed[rider])
    bend /= wp.max(1.0 - bend * offset, SHARPEST)
    turned = angle_from(level_tangent(path, s), riders.heading[rider])
    rate = PATH_RATE / speed
    curvature = bend + rate * rate * (riders.lane[rider] - offset)
    curvature -= 2.0 * rate * (turned - riders.lane_rate[rider] / speed)
    return wp.clamp(wp.atan(limits.wheelbase * curvature), -limits.max_steering, limits.max_steering)


@wp.kernel
def steer_user(
    # model
    rules: RoadRules,
    limits: BicycleLimits,
    body: UserBody,
    path: CentrelineData,
    # state in
    wish_in: wp.array[wp.float32],
    riders: RoadRiders,
    # out
    command_out: wp.array[wp.vec2],
):
    """Speed and steering angle from the speed that is wished for and the plan; one thread."""
    user = rules.first_user
    speed = wp.min(wish_in[0], climbing_speed(centreline_grade(path, riders.s[user]), body))
    command_out[0] = wp.vec2(speed, steering_along(user, riders, path, limits))


@wp.kernel
def place_user(
    # model
    rules: RoadRules,
    limits: BicycleLimits,
    path: CentrelineData,
    # state in
    riders: RoadRiders,
    bicycle: Bicycle,
    # out
    user_out: wp.array[wp.vec4],
    pose_out: wp.array[wp.transform],
):
    """The rear wheel's contact and velocity (x, y [m], vx, vy [m/s]), and the pose on the road; one thread."""
    place = bicycle.place[0]
    heading = bicycle.heading[0]
    speed = bicycle.speed[0]
    forward = direction(heading)
    rear = place - 0.5 * limits.wheelbase * forward
    user_out[0] = wp.vec4(rear[0], rear[1], speed * forward[0], speed * forward[1])
    s = centreline_closest(path, place, riders.s[rules.first_user])[0]
    height = centreline_position(path, s)[2]
    lean = wp.atan(speed * speed * wp.tan(bicycle.steering[0]) / (limits.wheelbase * GRAVITY))
    turned = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), heading)
    pitched = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), -wp.atan(centreline_grade(path, s)))
    leaned = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), -lean)
    pose_out[0] = wp.transform(wp.vec3(place[0], place[1], height), turned * pitched * leaned)


class RoadUser:
    """A simple bicycle on the road.

    Attributes:
        wish: How fast to ride [m/s], shape [1].
        controls: What the person on it does, by `person.CONTROLS`, where one rides.
        seen: What others see of it: rear contact x, y [m], velocity x, y [m/s]; shape [1].
        pose: World pose; origin on the centreline's height halfway between the wheels, x forward, y left, z up and
            leaning; shape [1].
    """

    def __init__(
        self,
        settings: UserSettings,
        rear: tuple[float, float],
        heading: float,
        speed: float,
        *,
        frame_rate: int,
        device: wp.DeviceLike = None,
    ) -> None:
        """Place it at its start.

        Args:
            settings: The bicycle.
            rear: Where its rear wheel touches the ground [m].
            heading: From x toward y [rad].
            speed: [m/s].
            frame_rate: Frames a second.
            device: Where the arrays live.
        """
        self._device = device
        self._limits = _limits(settings, frame_rate)
        self._body = UserBody()
        self._body.power, self._body.mass, self._body.drag_area = settings.power, settings.mass, settings.drag_area
        self._walls = wall_grid(WorldSettings(ground="plane"), 1.0, device)
        ahead = np.array([math.cos(heading), math.sin(heading)])
        place = np.array(rear) + 0.5 * settings.wheelbase * ahead
        bicycle = Bicycle()
        bicycle.place = wp.array(place[None].astype(np.float32), dtype=wp.vec2, device=device)
        bicycle.heading = wp.array([heading], dtype=wp.float32, device=device)
        bicycle.speed = wp.array([speed], dtype=wp.float32, device=device)
        bicycle.steering = wp.zeros(1, dtype=wp.float32, device=device)
        self._bicycle = bicycle
        self._command = wp.zeros(1, dtype=wp.vec2, device=device)
        self._middle = wp.zeros(1, dtype=wp.vec4, device=device)
        by_person = settings.by == "person"
        self._person = person_body(settings.power, settings.mass, settings.drag_area, device) if by_person else None
        self.controls = no_controls(device)
        self.wish = wp.zeros(1, dtype=wp.float32, device=device)
        self.seen = wp.array([(*rear, *(speed * ahead))], dtype=wp.vec4, device=device)
        self.pose = wp.zeros(1, dtype=wp.transform, device=device)

    def enqueue(self, rules: RoadRules, path: CentrelineData, riders: RoadRiders) -> None:
        """Launch what takes it from this frame to the next; can be captured in a graph."""
        device = self._device
        if self._person is not None:
            inputs = [rules, self._limits, self._person, path, self.controls, self._bicycle, riders]
            wp.launch(ride_on_road, dim=1, inputs=inputs, outputs=[self._command], device=device)
        else:
            inputs = [rules, self._limits, self._body, path, self.wish, riders]
            wp.launch(steer_user, dim=1, inputs=inputs, outputs=[self._command], device=device)
        inputs = [self._limits, self._walls, self._command, self._bicycle]
        wp.launch(ride, dim=1, inputs=inputs, outputs=[self._middle, self.pose], device=device)
        self.enqueue_place(rules, path, riders)

    def enqueue_place(self, rules: RoadRules, path: CentrelineData, riders: RoadRiders) -> None:
        """Launch only what says where it is."""
        inputs = [rules, self._limits, path, riders, self._bicycle]
        wp.launch(place_user, dim=1, inputs=inputs, outputs=[self.seen, self.pose], device=self._device)

    def speed_and_steering(self) -> tuple[float, float]:
        """Of the bicycle: speed [m/s] and angle of the front wheel, positive to the left [rad]."""
        return float(self._bicycle.speed.numpy()[0]), float(self._bicycle.steering.numpy()[0])

    def state(self) -> dict[str, wp.array]:
        """What the next frame depends on, by name; the arrays themselves."""
        bicycle = self._bicycle
        return {
            "place": bicycle.place,
            "heading": bicycle.heading,
            "speed": bicycle.speed,
            "steering": bicycle.steering,
            "seen": self.seen,
            "pose": self.pose,
        }


def _limits(settings: UserSettings, frame_rate: int) -> BicycleLimits:
    limits = BicycleLimits()
    limits.max_speed = MAX_SPEED
    limits.max_acceleration = settings.max_acceleration
    if settings.by == "person":  # whose legs and brakes are the limit
        limits.max_acceleration = max(settings.max_acceleration, float(BRAKES) / float(BRAKING))
    limits.max_steering = math.atan(settings.wheelbase / settings.turning_radius)
    limits.steering_rate = settings.steering_rate
    limits.wheelbase = settings.wheelbase
    limits.step = 1.0 / frame_rate
    return limits
