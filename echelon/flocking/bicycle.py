"""The collie's bicycle: it follows commands as well as a bicycle can.

A *command* is (desired speed [m/s], desired steering angle [rad], positive to the left), from whoever drives: the
dog, the waypoints of a scenario, or a person. Acceleration, steering rate, turning radius and lean are limited, it
does not reverse, and fences stop it. The rear wheel follows an arc whose curvature is the tangent of the steering
angle over the wheelbase.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.terrain.walls import WallGrid, nearest_wall_within

wp.set_module_options({"enable_backward": False})

GRAVITY = wp.constant(9.80665)  # [m/s^2]
SIDE_ACCELERATION = wp.constant(4.0)  # [m/s^2]; greatest in a bend, a lean of 22 degrees
BRAKING = wp.constant(1.5)  # greatest braking, over the greatest acceleration
BODY_RADIUS = wp.constant(0.6)  # [m]; fences stop the middle of the bicycle this far away
SCRAPE_RATE = wp.constant(1.5)  # [rad/s]; a fence that it runs into turns it alongside
STUCK = wp.constant(0.3)  # [m/s]; slower than this before a fence, it is turned to where it is steered
STEERED = wp.constant(0.02)  # [rad]; less than this is straight ahead


@wp.struct
class BicycleLimits:
    """`CollieSettings` as kernels see them; units as there.

    Attributes:
        max_steering: Of the front wheel, from the turning radius [rad].
        step: Duration of a frame [s].
    """

    max_speed: wp.float32
    max_acceleration: wp.float32
    max_steering: wp.float32
    steering_rate: wp.float32
    wheelbase: wp.float32
    step: wp.float32


@wp.struct
class Bicycle:
    """State of the bicycle; arrays of one.

    Attributes:
        place: Middle between the wheels [m].
        heading: From x toward y [rad].
        speed: Of the rear wheel [m/s], never negative.
        steering: Angle of the front wheel, positive to the left [rad].
    """

    place: wp.array[wp.vec2]
    heading: wp.array[wp.float32]
    speed: wp.array[wp.float32]
    steering: wp.array[wp.float32]


@wp.func
def direction(heading: float) -> wp.vec2:
    """The unit vector of a heading."""
    return wp.vec2(wp.cos(heading), wp.sin(heading))


@wp.func
def cross(a: wp.vec2, b: wp.vec2) -> float:
    """The z component of the cross product of two vectors on the ground."""
    return a[0] * b[1] - a[1] * b[0]


@wp.func
def angle_from(a: wp.vec2, b: wp.vec2) -> float:
    """The angle by which a must turn to the left to point along b, from -pi to pi [rad]."""
    return wp.atan2(cross(a, b), wp.dot(a, b))


@wp.func
def steering_toward(aim: wp.vec2, bicycle: Bicycle, limits: BicycleLimits) -> float:
    """Pure pursuit: the steering angle of the circle that leads to `aim`; full lock where that lies behind [rad]."""
    forward = direction(bicycle.heading[0])
    gap = aim - bicycle.place[0]
    distance = wp.max(wp.length(gap), 0.1)
    side = cross(forward, gap) / distance
    if wp.dot(forward, gap) <= 0.0:
        return wp.where(side < 0.0, -limits.max_steering, limits.max_steering)
    return wp.clamp(wp.atan(2.0 * limits.wheelbase * side / distance), -limits.max_steering, limits.max_steering)


@wp.kernel
def ride(
    # model
    limits: BicycleLimits,
    walls: WallGrid,
    # in
    command_in: wp.array[wp.vec2],
    # state in and out
    bicycle: Bicycle,
    # out
    user_out: wp.array[wp.vec4],
    pose_out: wp.array[wp.transform],
):
    """Advance by one frame; one thread."""
    step = limits.step
    command = command_in[0]
    gain = wp.clamp(
        command[0] - bicycle.speed[0], -BRAKING * limits.max_acceleration * step, limits.max_acceleration * step
    )
    speed = wp.clamp(bicycle.speed[0] + gain, 0.0, limits.max_speed)
    turn = wp.clamp(command[1] - bicycle.steering[0], -limits.steering_rate * step, limits.steering_rate * step)
    leaning = wp.atan(SIDE_ACCELERATION * limits.wheelbase / wp.max(speed * speed, 1.0e-3))
    lock = wp.min(limits.max_steering, leaning)
    steering = wp.clamp(bicycle.steering[0] + turn, -lock, lock)

    curvature = wp.tan(steering) / limits.wheelbase
    before = bicycle.heading[0]
    half_turn = 0.5 * speed * step * curvature
    after = before + 2.0 * half_turn
    chord = speed * step
    if wp.abs(half_turn) > 1.0e-3:
        chord *= wp.sin(half_turn) / half_turn
    rear = bicycle.place[0] - 0.5 * limits.wheelbase * direction(before) + chord * direction(before + half_turn)
    place = rear + 0.5 * limits.wheelbase * direction(after)

    wall = nearest_wall_within(place, walls)
    if wall[2] < BODY_RADIUS and wall[2] > 1.0e-6:
        away = (place - wp.vec2(wall[0], wall[1])) / wall[2]
        into = wp.clamp(-wp.dot(direction(after), away), 0.0, 1.0)
        place += (BODY_RADIUS - wall[2]) * away
        speed *= 1.0 - into * into
        side = wp.where(cross(direction(after), away) < 0.0, -1.0, 1.0)
        if speed < STUCK and wp.abs(steering) > STEERED:
            # In a corner each fence turns it towards the other, and it cannot reverse: who is in there gets it round
            # with a foot on the ground.
            side = wp.sign(steering)
        after += side * wp.min(wp.asin(into), SCRAPE_RATE * step)

    after = wp.atan2(wp.sin(after), wp.cos(after))
    velocity = (place - bicycle.place[0]) / step
    bicycle.place[0] = place
    bicycle.heading[0] = after
    bicycle.speed[0] = speed
    bicycle.steering[0] = steering
    user_out[0] = wp.vec4(place[0], place[1], velocity[0], velocity[1])
    # Into a bend to the left it leans to the left, which is a negative turn about the axis that points forward.
    lean = wp.atan(speed * speed * curvature / GRAVITY)
    upright = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), after)
    leaned = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), -lean)
    pose_out[0] = wp.transform(wp.vec3(place[0], place[1], 0.0), upright * leaned)
