"""What a gymnast measures of itself, for balance, for transitions and for those who judge.

All of it is ordinary Python over scalars, computed once a control tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from echelon.warp_kernels.character import View
from echelon.warp_kernels.kinematics import Kinematics
from echelon.warp_kernels.model import ContactSite
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.spatial import Vector, add, apply, cross, scale
from echelon.warp_kernels.trace import asin, atan2, clamp, maximum, minimum, select, sqrt

MEASURES: tuple[str, ...] = (
    "row_age", "time", "foot_force", "hand_force", "unloaded", "hands_unloaded", "foot_clearance", "hand_clearance",
    "com_x", "com_y", "com_height", "vx", "vy", "vz", "pitch", "pitch_rate", "lean", "upright", "somersault", "twist",
    "momentum_x", "momentum_y", "momentum_z", "hip", "knee", "knee_rate", "knee_rate_share", "feet_x", "touchdowns",
    "time_ahead", "somersault_ahead", "reaction",
)  # fmt: skip
"""What clauses of scripts may ask about: time in the row and since the start [s]; forces on feet and hands [N], and how
long they have felt none [s]; how far the lowest of them is from the ground [m]; the centre of mass from the middle of
the feet and over the ground [m] and its velocity [m/s]; pitch, its rate and sideways lean of the pelvis [rad], [rad/s],
the cosine of its tilt; somersault and twist since the start [rad], forward and to the left, which are angles of the
pelvis about y and z with its lean between them; angular momentum about the centre of mass [kg m^2/s], about axes
forward, left and up; mean hip and knee angle [rad], knee rate [rad/s] and as a share of the greatest in this row; the
feet from the centre of mass [m]; how often the feet came down; in flight, how long until the centre of mass is down at
`ahead_height` [s], and what the somersault will be then with `ahead_inertia` from now on [rad]; the vertical force of
the ground on the whole body, mean of the last tick [N], which is what the body's momentum tells of."""


def mass_in_motion(body: Body, kin: Kinematics) -> tuple[Vector, Vector, Vector]:
    """Centre of mass [m], its velocity [m/s], and the angular momentum about it [kg m^2/s]; world axes."""
    total = body.mass
    center: Vector = [0.0, 0.0, 0.0]
    velocity: Vector = [0.0, 0.0, 0.0]
    momentum: Vector = [0.0, 0.0, 0.0]
    for index, link in enumerate(body.links):
        place = kin.tree.node_of_link[index]
        rotation, origin = kin.world(place)
        at = add(origin, apply(rotation, list(link.com)))
        omega = kin.omega[place]
        moving = add(kin.world_velocity(place), apply(rotation, cross(omega, list(link.com))))
        spin = [sum(link.inertia[i][j] * omega[j] for j in range(3) if link.inertia[i][j] != 0.0) for i in range(3)]
        center = add(center, scale(link.mass / total, at))
        velocity = add(velocity, scale(link.mass / total, moving))
        momentum = add(momentum, add(apply(rotation, spin), scale(link.mass, cross(at, moving))))
    momentum = add(momentum, scale(-total, cross(center, velocity)))
    return center, velocity, momentum


def place_of(body: Body, kin: Kinematics, site: ContactSite) -> Vector:
    """Where a contact site is in the world [m]."""
    rotation, origin = kin.world(kin.tree.node_of_link[body.link_index(site.link)])
    return add(origin, apply(rotation, list(site.position)))


def measure_pelvis(view: View, facing: Callable[[Sequence[Any]], Vector]) -> None:
    """How the pelvis is turned, and how far it has turned since the start."""
    memory = view.memory
    rotation, _ = view.kin.world(0)
    up = facing([rotation[i][2] for i in range(3)])
    pitch = atan2(up[0], up[2])
    memory["somersault"] = memory["somersault"] + shorter_way(pitch - memory["last_pitch"])
    memory["last_pitch"] = pitch
    memory["pitch"] = pitch
    memory["lean"] = asin(clamp(up[1], -1.0, 1.0))
    memory["upright"] = up[2]
    spin = facing(apply(rotation, view.kin.omega[0]))
    memory["pitch_rate"] = spin[1]
    # Somersault, lean and twist are angles about y, then x, then z: how fast the body turns about its long axis is
    # not how fast it twists while it somersaults tilted.
    forwards, sideways = (facing([rotation[i][axis] for i in range(3)])[1] for axis in range(2))
    around = atan2(forwards, sideways)
    memory["twist"] = memory["twist"] + shorter_way(around - memory["last_twist"])
    memory["last_twist"] = around


def look_ahead(memory: dict[str, Any], gravity: float) -> None:
    """How long the fall still takes, and how far the body will have turned by then."""
    speed, height = memory["vz"], memory["com_height"] - memory["row.ahead_height"]
    root = sqrt(maximum(speed * speed + 2.0 * gravity * height, 0.0))
    memory["time_ahead"] = (1.0 / gravity) * (speed + root)
    turn = memory["momentum_y"] * memory["time_ahead"] / maximum(memory["row.ahead_inertia"], 0.1)
    memory["somersault_ahead"] = memory["somersault"] + turn


def least(values: Sequence[Any]) -> Any:
    least = values[0]
    for value in values[1:]:
        least = minimum(least, value)
    return least


def middle(values: Sequence[Any]) -> Any:
    """Half way between the least and the greatest."""
    greatest = values[0]
    for value in values[1:]:
        greatest = maximum(greatest, value)
    return 0.5 * (least(values) + greatest)


def mean(values: Sequence[Any]) -> Any:
    return total(values) * (1.0 / len(values))


def total(values: Sequence[Any]) -> Any:
    total: Any = 0.0
    for value in values:
        total = total + value
    return total


def shorter_way(turn: Any) -> Any:
    """A difference of two angles as the turn between -pi and pi that makes it [rad]."""
    return select(math.pi < turn, turn - 2.0 * math.pi, select(turn < -math.pi, turn + 2.0 * math.pi, turn))
