"""A person on the user's bicycle: what somebody does with pedals, brake, handlebars and gears, each frame.

The papers' user rode a stationary bicycle whose simple dynamics moved an avatar; here are those dynamics. Legs push as
muscles do, less the faster they turn: with e the effort, P the rider's strength, c the cadence, c0 the best one and d
the development of the gear, how far a turn of the cranks goes,

    drive = e P / (c0 d) (2 - c / c0),      c = v / d

so that the power is greatest, e P, at the best cadence, a low gear climbs, a high one is fast, and the wrong one is
neither. A bicycle trainer measures power instead; then drive = power / v. Against it are weight, air, rolling and the
brake. The speed that comes of it is a command to the bicycle (`bicycle`), whose limits stay.

Steering is the angle of the front wheel, or, where the person leans as on a recumbent, the lean al that the bend is
ridden with: tan(steering) = wheelbase g tan(al) / v^2. Either is at most `STEERING_LIMIT`.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import numpy as np
import warp as wp

from echelon.flocking.bicycle import GRAVITY, Bicycle, BicycleLimits
from echelon.flocking.road_riders import RoadRiders, RoadRules
from echelon.terrain.spline_kernels import CentrelineData, centreline_grade

wp.set_module_options({"enable_backward": False})

CONTROLS = ("effort", "power", "brake", "steering", "leaning", "gear")
"""What a person does in a frame: effort and brake from 0 to 1, measured power [W] or 0, angle to the left [rad],
whether that is a lean (0 or 1), and the gear, from 1."""

DEVELOPMENTS = (2.1, 2.5, 3.0, 3.5, 4.2, 5.0, 5.9, 7.0, 8.0, 9.2)
"""How far a turn of the cranks goes in each gear [m]."""

STEERING_LIMIT = math.radians(20.0)  # [rad]
FIRST_GEAR = 4  # that it sets off in
BEST_CADENCE = wp.constant(1.5)  # [1/s]
AIR_DENSITY = wp.constant(1.2)  # [kg/m^3]
ROLLING = wp.constant(0.005)  # rolling resistance over weight, on a road...
GRASS_ROLLING = wp.constant(0.05)  # ... and beside it
BRAKES = wp.constant(4.5)  # [m/s^2]
SLOWEST = wp.constant(0.5)  # [m/s]; below this speed a measured power pushes as at this speed
AHEAD = wp.constant(0.5)  # [s]; others take the person to be about where it will then be

_EFFORT = wp.constant(CONTROLS.index("effort"))
_POWER = wp.constant(CONTROLS.index("power"))
_BRAKE = wp.constant(CONTROLS.index("brake"))
_STEERING = wp.constant(CONTROLS.index("steering"))
_LEANING = wp.constant(CONTROLS.index("leaning"))
_GEAR = wp.constant(CONTROLS.index("gear"))


@wp.struct
class PersonBody:
    """Who rides.

    Attributes:
        strength: Power at the best cadence [W].
        mass: With the bicycle [kg].
        drag_area: Drag coefficient times frontal area [m^2].
        developments: Of the gears [m].
    """

    strength: wp.float32
    mass: wp.float32
    drag_area: wp.float32
    developments: wp.array[wp.float32]


def person_body(strength: float, mass: float, drag_area: float, device: wp.DeviceLike = None) -> PersonBody:
    """A person for kernels; units as in `PersonBody`."""
    body = PersonBody()
    body.strength, body.mass, body.drag_area = strength, mass, drag_area
    body.developments = wp.array(DEVELOPMENTS, dtype=wp.float32, device=device)
    return body


def no_controls(device: wp.DeviceLike = None) -> wp.array[wp.float32]:
    """Controls of a person who does nothing, shape [controls]."""
    return wp.array(hands_off(), dtype=wp.float32, device=device)


def hands_off() -> np.ndarray:
    """The same as numbers, float32, shape [controls]."""
    controls = np.zeros(len(CONTROLS), np.float32)
    controls[CONTROLS.index("gear")] = FIRST_GEAR
    return controls


def cadence_of(speed: float, gear: int) -> float:
    """Of the cranks at a speed [m/s] in a gear, from 1 [1/s]."""
    return speed / DEVELOPMENTS[gear - 1]


def power_of(controls: np.ndarray, speed: float, strength: float) -> float:
    """What a person with these controls pedals with at a speed [m/s] [W]."""
    measured = float(controls[CONTROLS.index("power")])
    if measured > 0.0:
        return measured
    turning = cadence_of(speed, int(controls[CONTROLS.index("gear")])) / float(BEST_CADENCE)
    return float(controls[CONTROLS.index("effort")]) * strength * turning * max(2.0 - turning, 0.0)


@wp.func
def drive_of(controls: wp.array[wp.float32], speed: float, body: PersonBody) -> float:
    """What pushes the bicycle forward [N]."""
    if controls[_POWER] > 0.0:
        return controls[_POWER] / wp.max(speed, SLOWEST)
    gear = wp.clamp(int(controls[_GEAR]), 1, body.developments.shape[0])
    development = body.developments[gear - 1]
    turning = speed / (development * BEST_CADENCE)
    return controls[_EFFORT] * body.strength / (BEST_CADENCE * development) * wp.max(2.0 - turning, 0.0)


@wp.func
def speed_after(
    controls: wp.array[wp.float32], speed: float, grade: float, rolling: float, body: PersonBody, step: float
) -> float:
    """The speed a frame later [m/s], never negative: a brake holds, and nobody rolls back."""
    slope = wp.sqrt(1.0 + grade * grade)
    drag = 0.5 * AIR_DENSITY * body.drag_area * speed * speed
    gain = (drive_of(controls, speed, body) - drag) / body.mass - GRAVITY * (grade + rolling) / slope
    return wp.max(speed + step * (gain - BRAKES * controls[_BRAKE]), 0.0)


@wp.func
def steering_of(controls: wp.array[wp.float32], speed: float, limits: BicycleLimits) -> float:
    """The angle of the front wheel that is asked for, positive to the left [rad]."""
    angle = controls[_STEERING]
    if controls[_LEANING] > 0.5:
        angle = wp.atan(limits.wheelbase * GRAVITY * wp.tan(angle) / wp.max(speed * speed, 1.0))
    return wp.clamp(angle, -limits.max_steering, limits.max_steering)


@wp.kernel
def ride_on_field(
    # model
    limits: BicycleLimits,
    body: PersonBody,
    # in
    controls_in: wp.array[wp.float32],
    bicycle: Bicycle,
    # out
    command_out: wp.array[wp.vec2],
):
    """Speed and steering angle from what a person does on level grass that is mown short; one thread."""
    speed = bicycle.speed[0]
    after = speed_after(controls_in, speed, 0.0, ROLLING, body, limits.step)
    command_out[0] = wp.vec2(after, steering_of(controls_in, speed, limits))


@wp.kernel
def ride_on_road(
    # model
    rules: RoadRules,
    limits: BicycleLimits,
    body: PersonBody,
    path: CentrelineData,
    # in
    controls_in: wp.array[wp.float32],
    bicycle: Bicycle,
    # state in and out
    riders: RoadRiders,
    # out
    command_out: wp.array[wp.vec2],
):
    """The same on a road and beside it; what others take to be this rider's plan is to go on as now; one thread."""
    user = rules.first_user
    speed = bicycle.speed[0]
    off_road = wp.abs(riders.offset[user]) > rules.half_width
    rolling = wp.where(off_road, GRASS_ROLLING, ROLLING)
    after = speed_after(controls_in, speed, centreline_grade(path, riders.s[user]), rolling, body, limits.step)
    command_out[0] = wp.vec2(after, steering_of(controls_in, speed, limits))
    plan = riders.offset[user] + AHEAD * riders.sideways[user]
    riders.lane[user] = plan
    riders.target[user] = plan
    riders.lane_rate[user] = riders.sideways[user]
    riders.command_speed[user] = after
