"""What a bicycle looks like: tubes, bars, saddle, cranks and wheels, as shapes on its links."""

from __future__ import annotations

import math

import numpy as np

from echelon.warp_kernels.model import Vec3, Visual
from echelon.warp_kernels.spatial import quaternion_product

Quaternion = tuple[float, float, float, float]

ALLOY: Vec3 = (0.55, 0.56, 0.58)
DARK: Vec3 = (0.03, 0.03, 0.035)
RUBBER: Vec3 = (0.02, 0.02, 0.02)
TAPE: Vec3 = (0.05, 0.05, 0.06)

ACROSS: Quaternion = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""Turns a shape's z axis across the bicycle, along y."""

SPOKES = 16
DROP = 0.13  # of the lower part of the bars below the hoods [m]


def tube(start: Vec3, end: Vec3, radius: float, color: Vec3 | None, *, capped: bool = True) -> Visual:
    """A round tube between two points that must differ [m]; without caps, its ends are flat and best hidden."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(b - a))
    x, y, z = (float(v) for v in 0.5 * (a + b))
    shape = "capsule" if capped else "cylinder"
    return Visual(shape, (radius, 0.5 * length, 0.0), (x, y, z), _from_z((b - a) / length), color)


def _from_z(direction: np.ndarray) -> Quaternion:
    """The quaternion (x, y, z, w) that turns +z to a unit vector the shortest way."""
    x, y, z = (float(v) for v in direction)
    if z < -1.0 + 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    w = math.sqrt(0.5 * (1.0 + z))
    return (-0.5 * y / w, 0.5 * x / w, 0.0, w)


def _about_x(angle: float) -> Quaternion:
    return (math.sin(0.5 * angle), 0.0, 0.0, math.cos(0.5 * angle))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """First b, then a."""
    x, y, z, w = quaternion_product(list(a), list(b))
    return (x, y, z, w)


def _between(a: Vec3, b: Vec3, part: float) -> Vec3:
    return (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))


def _beside(point: Vec3, y: float) -> Vec3:
    return (point[0], point[1] + y, point[2])


def frame_visuals(
    *, rear_hub: Vec3, bottom_bracket: Vec3, saddle: Vec3, head_bottom: Vec3, head_top: Vec3
) -> tuple[Visual, ...]:
    """Main triangle in the colour of the individual, stays, seat post and saddle; points in the frame's link [m]."""
    cluster = _between(bottom_bracket, saddle, 0.74)
    post_top = _between(bottom_bracket, saddle, 0.94)
    down_end, top_end = _between(head_bottom, head_top, 0.2), _between(head_bottom, head_top, 0.8)
    parts = [
        tube(bottom_bracket, cluster, 0.016, None),
        tube(cluster, top_end, 0.015, None),
        tube(bottom_bracket, down_end, 0.020, None),
        tube(head_bottom, head_top, 0.020, None),
        tube(cluster, post_top, 0.0135, DARK, capped=False),
        Visual("cylinder", (0.024, 0.036, 0.0), bottom_bracket, ACROSS, DARK),
        Visual("cylinder", (0.010, 0.065, 0.0), rear_hub, ACROSS, ALLOY),
        # A saddle: broad behind, a nose in front.
        Visual("ellipsoid", (0.085, 0.070, 0.024), (saddle[0] - 0.055, 0.0, saddle[2] - 0.024), color=DARK),
        Visual("ellipsoid", (0.130, 0.026, 0.020), (saddle[0] + 0.045, 0.0, saddle[2] - 0.026), color=DARK),
    ]
    for side in (0.06, -0.06):
        parts.append(tube(_beside(bottom_bracket, 0.5 * side), _beside(rear_hub, side), 0.010, None, capped=False))
        parts.append(tube(_beside(cluster, 0.3 * side), _beside(rear_hub, side), 0.008, None, capped=False))
    return tuple(parts)


def fork_visuals(*, hub: Vec3, crown: Vec3, stem: Vec3, grip: Vec3) -> tuple[Visual, ...]:
    """Blades, stem and drop bars; points in the fork's link, `grip` of the left hand [m]."""
    width = grip[1]
    clamp = (grip[0] - 0.095, 0.0, grip[2] - 0.02)
    parts = [
        Visual("cylinder", (0.010, 0.055, 0.0), hub, ACROSS, ALLOY),
        tube(crown, stem, 0.014, ALLOY, capped=False),
        tube(stem, clamp, 0.014, ALLOY),
        tube(_beside(clamp, -width), _beside(clamp, width), 0.0145, TAPE),
        tube(_beside(crown, -0.04), _beside(crown, 0.04), 0.018, None),
    ]
    for side in (1.0, -1.0):
        end = _beside(clamp, side * width)
        hood = (grip[0], side * width, grip[2] - 0.012)
        bend = (grip[0] - 0.012, side * width, grip[2] - 0.07)
        drop = (grip[0] - 0.06, side * width, grip[2] - DROP)
        tail = (grip[0] - 0.15, side * width, grip[2] - DROP - 0.008)
        parts += [
            tube(_beside(crown, side * 0.045), _beside(hub, side * 0.052), 0.011, None, capped=False),
            tube(end, hood, 0.0155, TAPE),
            Visual("ellipsoid", (0.030, 0.017, 0.036), (hood[0] + 0.008, hood[1], hood[2] + 0.012), color=DARK),
            tube(hood, bend, 0.015, TAPE),
            tube(bend, drop, 0.015, TAPE),
            tube(drop, tail, 0.015, TAPE),
            # The brake lever hangs from the hood.
            tube((hood[0] + 0.025, hood[1], hood[2]), (hood[0] + 0.012, hood[1], hood[2] - 0.085), 0.006, ALLOY),
        ]
    return tuple(parts)


def wheel_visuals(radius: float) -> tuple[Visual, ...]:
    """Tyre, rim, hub and crossed pairs of spokes about the wheel's axle, along y [m]."""
    tyre, rim = 0.013, 0.011
    parts = [
        Visual("torus", (radius - tyre, tyre, 0.0), orientation=ACROSS, color=RUBBER),
        Visual("torus", (radius - 2.0 * tyre - 0.5 * rim, rim, 0.0), orientation=ACROSS, color=DARK),
        Visual("cylinder", (0.022, 0.035, 0.0), orientation=ACROSS, color=ALLOY),
    ]
    half = 0.5 * (radius - 2.0 * tyre)
    lean = math.atan2(0.03, 2.0 * half)  # of a spoke, from the hub's flange to the rim
    for spoke in range(SPOKES):
        angle = 2.0 * math.pi * spoke / SPOKES
        side = 1.0 if spoke % 2 else -1.0
        place = (half * math.sin(angle), side * 0.015, half * math.cos(angle))
        turn = _product((0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle)), _about_x(side * lean))
        parts.append(Visual("box", (0.0016, 0.0016, half), place, turn, ALLOY))
    return tuple(parts)


def crank_visuals(crank_length: float, pedal_offset: float, center: Vec3 = (0.0, 0.0, 0.0)) -> tuple[Visual, ...]:
    """Two cranks, pedals and a chain ring about an axis along y; at angle zero the left crank points forward [m]."""
    x, y, z = center
    arm, ring = pedal_offset - 0.045, -0.042
    parts = [
        Visual("torus", (0.088, 0.007, 0.0), (x, y + ring, z), ACROSS, ALLOY),
        Visual("cylinder", (0.016, arm, 0.0), center, ACROSS, DARK),
    ]
    for side in (1.0, -1.0):
        foot = x + side * crank_length
        parts += [
            tube((x, y + side * arm, z), (foot, y + side * arm, z), 0.013, DARK),
            Visual("box", (0.045, 0.042, 0.010), (foot, y + side * pedal_offset, z), color=DARK),
        ]
    for arm_count in range(5):
        angle = 2.0 * math.pi * arm_count / 5.0
        place = (x + 0.042 * math.sin(angle), y + ring, z + 0.042 * math.cos(angle))
        turn = (0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle))
        parts.append(Visual("box", (0.009, 0.003, 0.044), place, turn, DARK))
    return tuple(parts)
