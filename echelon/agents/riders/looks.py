"""What a rider looks like: limbs, jersey, shorts, shoes and helmet, as shapes on the links.

Shapes are in their link's axes, x forward, y left, z up for someone who stands upright. The jersey has the colour of
the individual; the rest is the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from echelon.agents.riders.bicycle_looks import tube
from echelon.warp_kernels.model import Vec3, Visual

SKIN: Vec3 = (0.48, 0.25, 0.15)
SHORTS: Vec3 = (0.015, 0.015, 0.02)
SHOE: Vec3 = (0.75, 0.75, 0.72)
SOLE: Vec3 = (0.02, 0.02, 0.02)
SOCK: Vec3 = (0.80, 0.80, 0.80)
GLOVE: Vec3 = (0.03, 0.03, 0.035)
HELMET: Vec3 = (0.78, 0.79, 0.80)
VENT: Vec3 = (0.02, 0.02, 0.025)
NUMBER: Vec3 = (0.85, 0.85, 0.82)
PEDAL: Vec3 = (0.03, 0.03, 0.035)
GLASSES: Vec3 = (0.01, 0.01, 0.012)


def pelvis_visuals(hip: Vec3) -> tuple[Visual, ...]:
    """Hips and seat, in shorts."""
    width = hip[1]
    return (
        Visual("ellipsoid", (0.115, 0.160, 0.125), (-0.01, 0.0, 0.10), color=SHORTS),
        Visual("ellipsoid", (0.105, 0.135, 0.090), (-0.005, 0.0, 0.19)),
        *(Visual("ellipsoid", (0.095, 0.085, 0.10), (-0.02, s * 0.75 * width, 0.065), color=SHORTS) for s in (1, -1)),
    )


def trunk_visuals(shoulder: Vec3, neck: Vec3) -> tuple[Visual, ...]:
    """Waist, chest and shoulders in the jersey, a number on the back, and the neck."""
    _, width, height = shoulder
    return (
        Visual("ellipsoid", (0.105, 0.140, 0.17), (-0.005, 0.0, 0.10)),
        Visual("ellipsoid", (0.120, 0.170, 0.20), (-0.010, 0.0, 0.27)),
        tube((-0.005, width - 0.03, height), (-0.005, -width + 0.03, height), 0.062, None),
        # A race number low on the back.
        Visual("box", (0.012, 0.052, 0.055), (-0.107, 0.0, 0.17), (0.0, -0.035, 0.0, 0.9994), NUMBER),
        tube((0.005, 0.0, height), (neck[0] + 0.02, 0.0, neck[2] + 0.05), 0.055, SKIN),
    )


def head_visuals(neck: Vec3, flexion: float) -> tuple[Visual, ...]:
    """Head and helmet above the neck, the face lifted to the road by the rider's posture [rad]."""
    # On the bicycle the trunk leans forward by about 45 degrees; a rider lifts the chin to see.
    tilt = flexion - math.radians(18.0)
    turn = (0.0, math.sin(0.5 * tilt), 0.0, math.cos(0.5 * tilt))
    center = (neck[0] + 0.035, 0.0, neck[2] + 0.125)
    sine, cosine = math.sin(tilt), math.cos(tilt)

    def at(x: float, y: float, z: float) -> Vec3:
        return (center[0] + cosine * x + sine * z, y, center[2] - sine * x + cosine * z)

    shell: list[Visual] = [
        Visual("ellipsoid", (0.092, 0.074, 0.112), at(0.0, 0.0, 0.0), turn, SKIN),
        Visual("ellipsoid", (0.028, 0.018, 0.024), at(0.088, 0.0, -0.015), turn, SKIN),
        Visual("ellipsoid", (0.030, 0.072, 0.020), at(0.068, 0.0, 0.018), turn, GLASSES),
        Visual("ellipsoid", (0.138, 0.094, 0.078), at(-0.012, 0.0, 0.070), turn, HELMET),
        Visual("ellipsoid", (0.075, 0.070, 0.050), at(-0.090, 0.0, 0.050), turn, HELMET),
    ]
    for y in (-0.048, 0.0, 0.048):
        shell.append(Visual("ellipsoid", (0.110, 0.011, 0.068), at(-0.005, y, 0.088 - 4.0 * y * y), turn, VENT))
    return tuple(shell)


def upper_leg_visuals(length: float) -> tuple[Visual, ...]:
    """Thigh in shorts down to a hand's breadth above the knee."""
    return (
        Visual("ellipsoid", (0.094, 0.084, 0.42 * length), (0.004, 0.0, -0.28 * length), color=SHORTS),
        Visual("ellipsoid", (0.072, 0.066, 0.44 * length), (0.006, 0.0, -0.60 * length), color=SKIN),
        Visual("ellipsoid", (0.058, 0.052, 0.062), (0.008, 0.0, -length), color=SKIN),
    )


def lower_leg_visuals(length: float) -> tuple[Visual, ...]:
    """Calf, shin and sock."""
    return (
        Visual("ellipsoid", (0.056, 0.052, 0.34 * length), (-0.018, 0.0, -0.34 * length), color=SKIN),
        tube((0.0, 0.0, -0.10 * length), (0.0, 0.0, -0.80 * length), 0.036, SKIN),
        tube((0.0, 0.0, -0.74 * length), (0.0, 0.0, -length), 0.036, SOCK),
    )


def foot_visuals(sole: Vec3) -> tuple[Visual, ...]:
    """A shoe with a stiff sole, its ball on the pedal, and the pedal, which is clipped to it and turns with it."""
    ball, low = sole[0], sole[2]
    return (
        Visual("ellipsoid", (0.140, 0.045, 0.040), (ball - 0.055, 0.0, low + 0.048), color=SHOE),
        Visual("ellipsoid", (0.062, 0.038, 0.062), (-0.012, 0.0, -0.040), color=SHOE),
        Visual("ellipsoid", (0.138, 0.044, 0.012), (ball - 0.055, 0.0, low + 0.018), color=SOLE),
        Visual("box", (0.042, 0.036, 0.009), (ball, 0.0, low), color=PEDAL),
    )


def upper_arm_visuals(length: float) -> tuple[Visual, ...]:
    """Short sleeve, biceps and elbow."""
    return (
        Visual("ellipsoid", (0.062, 0.058, 0.46 * length), (0.0, 0.0, -0.22 * length)),
        Visual("ellipsoid", (0.046, 0.043, 0.42 * length), (0.004, 0.0, -0.60 * length), color=SKIN),
        Visual("ellipsoid", (0.040, 0.038, 0.042), (0.0, 0.0, -length), color=SKIN),
    )


def lower_arm_visuals(wrist: float) -> tuple[Visual, ...]:
    """Forearm, thinner towards the wrist."""
    return (
        Visual("ellipsoid", (0.042, 0.040, 0.52 * wrist), (0.0, 0.0, -0.40 * wrist), color=SKIN),
        tube((0.0, 0.0, -0.4 * wrist), (0.0, 0.0, -wrist), 0.026, SKIN),
    )


def hand_visuals(reach: float, wrist: float) -> tuple[Visual, ...]:
    """A gloved hand about the hood of the bars, in the lower arm's axes."""
    middle = 0.5 * (wrist + reach) + 0.01
    return (Visual("ellipsoid", (0.036, 0.040, 0.5 * (reach - wrist) + 0.025), (0.0, 0.0, -middle), color=GLOVE),)


def without_pedals(cranks: Sequence[Visual]) -> tuple[Visual, ...]:
    """Cranks whose pedals are drawn with the shoes: they do not turn with the cranks."""
    return tuple(visual for visual in cranks if visual.shape != "box")


def moved(visuals: Sequence[Visual], by: Vec3) -> tuple[Visual, ...]:
    """The same shapes in a link whose origin lies at minus `by`."""
    return tuple(
        replace(v, position=(v.position[0] + by[0], v.position[1] + by[1], v.position[2] + by[2])) for v in visuals
    )
