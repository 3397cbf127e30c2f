"""Inverse kinematics of a rider's legs and arms, over any scalars: traced, or NumPy arrays.

A leg moves in a plane: hip, knee and ankle turn about y, and the pedal goes round in that plane. With the angle of the
ankle given, shank and foot are one rigid piece, and hip and knee are those of a triangle. An arm reaches for the grip
with a gimbal at the shoulder, first about y, then x, then along the arm, and a hinge at the elbow; the turn along the
arm is chosen, so that elbows point outwards, and the other three angles follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from echelon.agents.riders.bicycle import BicycleParameters
from echelon.agents.riders.body import RiderParameters
from echelon.warp_kernels.spatial import Vector
from echelon.warp_kernels.trace import asin, atan2, clamp, maximum, sincos, sqrt

ANKLE_MEAN, ANKLE_SWING = math.radians(8.0), math.radians(12.5)
ANKLE_LEAD = math.radians(9.0)
"""The ankle flexes by mean + swing sin(crank + lead), after Cavanagh and Sanderson; crank 0 is this pedal on top."""


@dataclass(frozen=True)
class LegPose:
    """A leg with its foot on the pedal.

    Attributes:
        hip, knee, ankle: Flexion [rad].
        arms: From hip, knee and ankle to the pedal's axle, (x, z) in the pelvis's axes [m].
    """

    hip: Any
    knee: Any
    ankle: Any
    arms: tuple[tuple[Any, Any], tuple[Any, Any], tuple[Any, Any]]

    def torques(self, force: tuple[Any, Any]) -> tuple[Any, Any, Any]:
        """Torques at hip, knee and ankle that push the pedal with a force (x, z) in the pelvis's axes [N m]."""
        x, z = force
        hip, knee, ankle = ((z * arm[0] - x * arm[1]) for arm in self.arms)
        return hip, -knee, ankle


def leg_pose(rider: RiderParameters, bicycle: BicycleParameters, sine: Any, cosine: Any, pitch: Any) -> LegPose:
    """The leg whose crank stands at an angle from the top, growing as it drives forward.

    Args:
        rider: How long its legs are.
        bicycle: Where saddle and cranks are.
        sine, cosine: Of the crank's angle.
        pitch: Of the pelvis, forward, on the bicycle [rad].
    """
    ankle = ANKLE_MEAN + ANKLE_SWING * (math.cos(ANKLE_LEAD) * sine + math.sin(ANKLE_LEAD) * cosine)
    # The pedal from the saddle, then in the pelvis's axes and from the hip.
    x = bicycle.bottom_bracket[0] - bicycle.saddle[0] + bicycle.crank_length * sine
    z = bicycle.bottom_bracket[2] - bicycle.saddle[2] + bicycle.crank_length * cosine
    pitch_sine, pitch_cosine = sincos(pitch)
    d_x = pitch_cosine * x - pitch_sine * z - rider.hip[0]
    d_z = pitch_sine * x + pitch_cosine * z - rider.hip[2]
    # Shank and foot as one: from the knee to the pedal, in the shank's axes.
    ankle_sine, ankle_cosine = sincos(ankle)
    toe, sole = rider.sole[0], rider.sole[2]
    s_x = toe * ankle_cosine - sole * ankle_sine
    s_z = toe * ankle_sine + sole * ankle_cosine - rider.lower_leg_length
    thigh = rider.upper_leg_length
    shank_square = s_x * s_x + s_z * s_z
    reach_square = d_x * d_x + d_z * d_z
    # Law of cosines; the knee that is almost straight stays a little bent.
    bend_cosine = (reach_square - thigh * thigh - shank_square) / (2.0 * thigh * sqrt(shank_square))
    bend_cosine = clamp(bend_cosine, -0.98, 0.98)
    bend_sine = sqrt(1.0 - bend_cosine * bend_cosine)
    shank = sqrt(shank_square)
    knee = atan2(bend_sine, bend_cosine) + atan2(s_x, -s_z)
    hip = atan2(d_x, -d_z) + atan2(shank * bend_sine, thigh + shank * bend_cosine)
    hip_sine, hip_cosine = sincos(hip)
    foot_sine, foot_cosine = sincos(hip - knee + ankle)
    arms = (
        (d_x, d_z),
        (d_x - thigh * hip_sine, d_z + thigh * hip_cosine),
        (toe * foot_cosine - sole * foot_sine, toe * foot_sine + sole * foot_cosine),
    )
    return LegPose(hip, knee, ankle, arms)


class ArmReach:
    """The arms of a rider who sits still, reaching for bars that turn.

    It uses the rider's *nominal* posture: arms that followed the trunk's motion would steer with it.
    """

    def __init__(self, rider: RiderParameters, bicycle: BicycleParameters) -> None:
        self._upper, self._lower = rider.upper_arm_length, rider.lower_arm_length
        self._out = rider.elbows_out
        trunk = rider.pelvis_pitch + rider.waist_flexion
        waist = _pitched(rider.waist, rider.pelvis_pitch)
        axis = np.array(bicycle.steer_axis)
        stem = np.array(bicycle.on_steer_axis(bicycle.front_wheel.radius))
        self._reach: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        for sign in (1.0, -1.0):
            shoulder = np.array(bicycle.saddle) + waist + _pitched(_side(rider.shoulder, sign), trunk)
            arm = np.array(_side(bicycle.grip, sign)) - stem
            along = axis * (axis @ arm)
            # grip(steer) = still + cos(steer) across + sin(steer) turned, in the trunk's axes.
            parts = (stem + along - shoulder, arm - along, np.cross(axis, arm))
            still, across, turned = (_pitched(part, -trunk) for part in parts)
            self._reach[sign] = (still, across, turned)

    def angles(self, sign: float, sine: Any, cosine: Any) -> tuple[Any, Any, Any, float]:
        """Elbow, and shoulder about y (forward), x and z, that hold the grip at a steering angle [rad].

        Args:
            sign: 1 for the left arm, -1 for the right.
            sine, cosine: Of the steering angle, to the left.
        """
        still, across, turned = (part.tolist() for part in self._reach[sign])
        target: Vector = [still[i] + cosine * across[i] + sine * turned[i] for i in range(3)]
        a, b = self._upper, self._lower
        distance_square = target[0] * target[0] + target[1] * target[1] + target[2] * target[2]
        bend_cosine = clamp((distance_square - a * a - b * b) * (0.5 / (a * b)), -0.9, 0.99)
        bend_sine = sqrt(1.0 - bend_cosine * bend_cosine)
        elbow = atan2(bend_sine, bend_cosine)
        # The hand in the arm's axes, before and after the chosen turn along the arm: the elbow goes outwards.
        twist = -sign * self._out
        down = -(a + b * bend_cosine)
        ahead, beside = math.cos(twist) * b * bend_sine, math.sin(twist) * b * bend_sine
        across_x = sqrt(maximum(beside * beside + down * down, 1e-6))
        abduction = asin(target[1] / across_x) - atan2(beside, -down)
        sine_x, cosine_x = sincos(abduction)
        height = beside * sine_x + down * cosine_x
        forward = atan2(target[2], target[0]) - atan2(height, ahead)
        return elbow, forward, abduction, twist


def _side(place: tuple[float, float, float], sign: float) -> tuple[float, float, float]:
    return (place[0], sign * place[1], place[2])


def _pitched(vector: Any, pitch: float) -> np.ndarray:
    """A vector turned forward about y."""
    x, y, z = (float(v) for v in vector)
    return np.array([math.cos(pitch) * x + math.sin(pitch) * z, y, math.cos(pitch) * z - math.sin(pitch) * x])
