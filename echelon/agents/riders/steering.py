"""How a rider balances: equation 11 of *Animating Human Athletics*, with gains that depend on speed.

A bicycle is balanced by steering under the fall. The paper's law gives the angle of the fork from lean and heading,

    theta = -k_a (a - a_d) - k_a' a' + k_b (b - b_d) + k_b' (b' - b'_d)

with a the lean (to the right), b the heading (to the left), a dash for a rate and _d for what is desired. Its signs
make a rider who wants to go left steer *right* first: the wheels run out from beneath, the body leans left, and then
the fork follows the lean. Nobody programmed the counter-steering.

Two ways of wanting:

* **The paper's**: a heading. Lean and turning are desired to be zero, so heading follows a command that keeps turning
  with a lag. The heading error is capped at what a lean of `HEADING_LEAN` balances.
* **Pursuit**: a point on the road ahead. The circle through it that leaves along the heading has curvature
  2 sin(e) / L, with e the angle to the point and L its distance. At speed v it asks for a turning
  b'_d = v 2 sin(e) / L, for the lean a_d = -atan(v b'_d / g) that balances it, and for the fork angle of that circle,
  which is added. There is no term in the heading itself. The point is seen from where the bicycle will be in half a
  second, since leaning takes as long, and the curvature is filtered and held to the rate at which a body can be thrown
  over: a step of it would throw the rider.

The first two gains stand in one ratio, 0.34 s, the time in which an unsteered rider's lean grows by e: the law acts on
the lean as it will be if nothing is done. Gains are low where the loop has little delay to spare; arms and their
servos take 50 to 60 ms to bring the fork where it is wanted.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from echelon.agents.riders.bicycle import BicycleParameters
from echelon.warp_kernels.spatial import Matrix, apply, dot
from echelon.warp_kernels.trace import asin, atan2, clamp, maximum, minimum, select, sincos, sqrt

GRAVITY = 9.80665  # [m/s^2]

# Speed [m/s], and k_a, k_a' [s], k_b, k_b' [s].
GAINS: tuple[tuple[float, float, float, float, float], ...] = (
    (1.0, 6.65, 2.23, 0.05, 0.70),
    (1.5, 3.62, 1.22, 0.112, 0.467),
    (2.0, 2.35, 0.79, 0.20, 0.35),
    (3.0, 1.64, 0.56, 0.30, 0.21),
    (4.0, 1.19, 0.405, 0.32, 0.133),
    (5.0, 0.88, 0.30, 0.32, 0.091),
    (6.0, 0.67, 0.23, 0.28, 0.059),
    (8.0, 0.56, 0.19, 0.34, 0.018),
    (10.0, 0.31, 0.106, 0.235, 0.015),
    (12.0, 0.21, 0.070, 0.18, 0.009),
    (14.0, 0.15, 0.052, 0.156, 0.006),
    (20.0, 0.075, 0.026, 0.08, 0.003),
)

HEADING_LEAN = math.radians(25.0)  # a heading error counts for no more than what this lean outweighs
FORK_FILTER = 0.020  # time constant of the angle that the arms are asked for [s]
PURSUIT_FILTER = 0.08  # of the curvature that is wanted, twice one after the other [s]
TURNING_DELAY = 0.5  # from wanting a circle to riding it [s]
LEANING_RATE = 1.3  # at which the lean that is wanted may change [rad/s]
FORK_LIMIT = 0.9  # of the angle that arms can reach [rad]
LEAST_LOOK_AHEAD, LEAST_LOOK_TIME = 2.0, 1.35  # points nearer than this are taken to be as far [m], [s]
LEAST_RADIUS = 3.0  # of a circle that is asked for [m]
LEAST_SPEED = 0.5  # below which divisions by the speed stop growing [m/s]


@dataclass(frozen=True)
class Attitude:
    """How a bicycle stands and goes, measured against gravity.

    Attributes:
        speed: Along the frame [m/s].
        lean, lean_rate: To the right [rad], [rad/s].
        yaw_rate: To the left [rad/s].
        ahead: Unit vector of the heading in plan.
    """

    speed: Any
    lean: Any
    lean_rate: Any
    yaw_rate: Any
    ahead: tuple[Any, Any]

    @classmethod
    def of(cls, rotation: Matrix, velocity: Sequence[Any], omega: Sequence[Any]) -> Attitude:
        """From a frame's rotation to the world, its velocity there, and its angular velocity in its own axes."""
        across_x, across_y = rotation[0][1], rotation[1][1]
        inverse = 1.0 / sqrt(maximum(across_x * across_x + across_y * across_y, 1e-4))
        ahead = (across_y * inverse, -across_x * inverse)
        turning = apply(rotation, list(omega))
        along = [rotation[i][0] for i in range(3)]
        return cls(
            speed=dot(along, list(velocity)),
            lean=asin(rotation[2][1]),
            lean_rate=ahead[0] * turning[0] + ahead[1] * turning[1],
            yaw_rate=turning[2],
            ahead=ahead,
        )

    def bearing(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Sine and cosine, times the length, of the angle from the heading to a direction in plan, left positive."""
        return self.ahead[0] * y - self.ahead[1] * x, self.ahead[0] * x + self.ahead[1] * y


def scheduled_gains(speed: Any) -> tuple[Any, Any, Any, Any]:
    """k_a, k_a', k_b, k_b' at a speed: straight lines between the entries of `GAINS`."""
    values: list[Any] = list(GAINS[0][1:])
    for (low, *before), (high, *after) in itertools.pairwise(GAINS):
        within = clamp(speed - low, 0.0, high - low)
        for i in range(4):
            values[i] = values[i] + (after[i] - before[i]) / (high - low) * within
    return values[0], values[1], values[2], values[3]


def wanted_curvature(attitude: Attitude, x: Any, y: Any, look_ahead: Any, turning: Any, lean_limit: Any) -> Any:
    """Of the circle that leads to a point, left positive [1/m], no tighter than a lean allows.

    Leaning takes a while: a circle that is wanted now is ridden half a second later. So the point is seen from where
    the bicycle will be then if it goes on turning as it was last told to. On a circle nothing changes by that; without
    it a rider who looks less than about a second and a half ahead winds from side to side.

    Args:
        attitude: How the bicycle stands.
        x, y: Direction to the point in plan, of any length.
        look_ahead: Distance to the point [m].
        turning: Curvature that was asked for last [1/m].
        lean_limit: [rad], at most one.
    """
    sine, cosine = attitude.bearing(x, y)
    length = maximum(sqrt(sine * sine + cosine * cosine), 1e-6)
    speed = maximum(attitude.speed, LEAST_SPEED)
    look_ahead = maximum(look_ahead, maximum(LEAST_LOOK_TIME * speed, LEAST_LOOK_AHEAD))
    path = minimum(TURNING_DELAY * speed, 0.5 * look_ahead)
    turn = path * turning
    half_sine, half_cosine = sincos(0.5 * turn)
    # The point from there, in axes along the heading of now, then of then.
    chord = path * (1.0 - turn * turn * (1.0 / 24.0))
    ahead = look_ahead * (cosine / length) - chord * half_cosine
    beside = look_ahead * (sine / length) - chord * half_sine
    turn_sine, turn_cosine = 2.0 * half_sine * half_cosine, 1.0 - 2.0 * half_sine * half_sine
    ahead, beside = turn_cosine * ahead + turn_sine * beside, turn_cosine * beside - turn_sine * ahead
    distance = maximum(sqrt(ahead * ahead + beside * beside), 0.5 * LEAST_LOOK_AHEAD)
    # Behind, the way round is as if it were beside.
    sine = select(ahead < 0.0, select(beside < 0.0, -1.0, 1.0), beside / distance)
    curvature = 2.0 * sine / distance
    tangent = lean_limit * (1.0 + 0.42 * lean_limit * lean_limit)  # of up to a radian, within three per cent
    most = minimum(GRAVITY * tangent / (speed * speed), 1.0 / LEAST_RADIUS)
    return clamp(curvature, -most, most)


def filtered(value: Any, target: Any, time_constant: float, tick: float) -> Any:
    """One tick of a first-order low pass."""
    return value + (1.0 - math.exp(-tick / time_constant)) * (target - value)


def followed_curvature(before: Any, wanted: Any, speed: Any, tick: float) -> Any:
    """A tick on from a curvature to the one that is wanted, no faster than a body can be thrown over [1/m]."""
    speed = maximum(speed, LEAST_SPEED)
    most = (tick * LEANING_RATE * GRAVITY) / (speed * speed)
    change = (1.0 - math.exp(-tick / PURSUIT_FILTER)) * (wanted - before)
    return before + clamp(change, -most, most)


def pursuit_fork(attitude: Attitude, curvature: Any, bicycle: BicycleParameters) -> tuple[Any, Any]:
    """The fork angle that rides along a circle, and the lean that goes with it [rad]."""
    speed = maximum(attitude.speed, LEAST_SPEED)
    turning = speed * curvature
    tangent = speed * turning * (1.0 / GRAVITY)
    upright = 1.0 / sqrt(1.0 + tangent * tangent)
    lean = -atan2(tangent * upright, upright)
    gain_a, gain_rate, _, gain_turning = scheduled_gains(attitude.speed)
    law = (
        -gain_a * (attitude.lean - lean) - gain_rate * attitude.lean_rate + gain_turning * (attitude.yaw_rate - turning)
    )
    # On a circle the front wheel points off the frame by w / R, seen from above the leaning steer axis.
    angle = (bicycle.wheelbase / math.cos(bicycle.steer_tilt)) * curvature * upright
    circle = angle * (1.0 - angle * angle * (1.0 / 3.0))
    return law + circle, lean


def heading_fork(attitude: Attitude, x: Any, y: Any) -> Any:
    """The paper's law: the fork angle that turns towards a heading [rad]."""
    sine, cosine = attitude.bearing(x, y)
    error = -atan2(sine, cosine)
    gain_a, gain_rate, gain_heading, gain_turning = scheduled_gains(attitude.speed)
    most = gain_a * HEADING_LEAN
    return (
        -gain_a * attitude.lean
        - gain_rate * attitude.lean_rate
        + clamp(gain_heading * error, -most, most)
        + gain_turning * attitude.yaw_rate
    )
