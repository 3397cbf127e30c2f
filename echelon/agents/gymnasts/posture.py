"""Postures of a gymnast: channels and generalised positions, one from the other, and squats that balance.

A script asks for a depth of the legs and a pitch of the pelvis; which ankles that takes depends on where the arms and
the trunk carry the rest of the body. `balanced_legs` finds the lean of the legs that puts the centre of mass over the
middle of the feet, so that balance has little left to do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from echelon.agents.gymnasts.body import FOOT_SITES, TOE_SITES, LegGeometry
from echelon.agents.gymnasts.channels import (
    CHANNELS,
    LIMBS,
    NECK,
    NECK_JOINT,
    SHOULDER,
    SIDES,
    SPINE,
    SPINE_JOINTS,
    shoulder_orientation,
)
from echelon.errors import InputError
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.spatial import add, apply

LEANS = np.linspace(-0.6, 0.6, 41)
"""Leans of the line from ankle to hip that are tried, forward [rad]; between them one interpolates."""


def positions_of(body: Body, channels: Mapping[str, float | np.ndarray]) -> np.ndarray:
    """Generalised positions of channels, shape [..., q_count]; those that are not named are zero.

    The pelvis is where it is in the reference pose.

    Args:
        body: A gymnast's body with ball shoulders.
        channels: By name [rad], numbers or arrays of one shape.
    """
    shape = np.broadcast_shapes(*(np.shape(value) for value in channels.values())) if channels else ()
    angles = {name: np.broadcast_to(np.asarray(channels.get(name, 0.0), dtype=float), shape) for name in CHANNELS}
    joints = {link.joint.name: body.q_start(index) for index, link in enumerate(body.links)}
    q = np.tile(body.q_reference, (*shape, 1))
    for side in SIDES:
        for name, joint in LIMBS.items():
            sign = joint.sign * (joint.mirror if side == "right" else 1.0)
            q[..., joints[f"{side}_{joint.joint}"] + joint.axis] = sign * angles[f"{side}_{name}"]
        start = joints[f"{side}_shoulder"]
        turned = shoulder_orientation(side, *(angles[f"{side}_{name}"] for name in SHOULDER))
        q[..., start : start + 4] = np.stack(turned, axis=-1)
    for name, axis in SPINE.items():
        for joint in SPINE_JOINTS:
            q[..., joints[joint] + axis] = angles[name] / len(SPINE_JOINTS)
    for name, axis in NECK.items():
        q[..., joints[NECK_JOINT] + axis] = angles[name]
    return q


def channels_of(body: Body, q: np.ndarray) -> dict[str, float]:
    """Channels of the limbs at generalised positions q, shape [q_count]; zero for those that are not one axis each."""
    joints = {link.joint.name: body.q_start(index) for index, link in enumerate(body.links)}
    channels = dict.fromkeys(CHANNELS, 0.0)
    for side in SIDES:
        for name, joint in LIMBS.items():
            sign = joint.sign * (joint.mirror if side == "right" else 1.0)
            channels[f"{side}_{name}"] = sign * float(q[joints[f"{side}_{joint.joint}"] + joint.axis])
    return channels


def balanced_legs(
    body: Body, leg: LegGeometry, length: float, pitch: float, com_x: float, channels: Mapping[str, float]
) -> tuple[float, float, float]:
    """Hip, knee and ankle of a squat on flat feet whose centre of mass is over them [rad].

    Args:
        body, leg: Whose legs, and `body.leg_geometry` of it.
        length: From hip to ankle [m]; a longer one than the leg has stretches it.
        pitch: Of the pelvis, forward [rad].
        com_x: Of the centre of mass, ahead of the middle of the feet [m].
        channels: Where everything but the legs is [rad].

    Raises:
        InputError: No lean of the legs puts the centre of mass there.
    """
    _, knee, _ = leg_angles(leg, length)
    bend = knee + leg.thigh_lean - leg.shank_lean  # of the straight lines from hip to knee to ankle
    _, thigh = _triangle(leg, length)
    # The line from ankle to hip leans forward by LEANS; foot flat: pitch + hip + knee + ankle = 0.
    ankle = -(bend - thigh + LEANS) - leg.shank_lean
    hip = -pitch - knee - ankle
    moving = {f"{side}_{name}": value for side in SIDES for name, value in (("hip", hip), ("ankle", ankle))}
    q = positions_of(body, {**channels, **{f"{side}_knee": knee for side in SIDES}, **moving})
    root = body.q_start(0)
    q[..., root + 3 : root + 7] = (0.0, np.sin(0.5 * pitch), 0.0, np.cos(0.5 * pitch))
    ahead = body.center_of_mass(q)[..., 0] - middle_of_feet(body, q) - com_x
    order = np.argsort(ahead)
    if not ahead[order[0]] <= 0.0 <= ahead[order[-1]]:
        raise InputError(
            f"length {length:.3f} m with a pitch of {pitch:.2f} rad cannot balance {com_x:.3f} m ahead of the feet"
        )
    ankle_here = float(np.interp(0.0, ahead[order], ankle[order]))
    return -pitch - knee - ankle_here, knee, ankle_here


def middle_of_feet(body: Body, q: np.ndarray) -> np.ndarray:
    """Middle of both soles along x [m], shape [...]."""
    kin = body.kinematics(q, np.zeros((*q.shape[:-1], body.u_count)))
    names = {name for sites in (FOOT_SITES, TOE_SITES) for of_side in sites.values() for name in of_side}
    places = []
    for site in body.contacts:
        if site.name in names:
            rotation, origin = kin.world(kin.tree.node_of_link[body.link_index(site.link)])
            places.append(add(origin, apply(rotation, list(site.position)))[0])
    return 0.5 * (np.min(places, axis=0) + np.max(places, axis=0))


def leg_angles(leg: LegGeometry, length: float) -> tuple[float, float, float]:
    """Hip, knee and ankle for a distance from hip to ankle, with the hip straight above the ankle [rad].

    Equations 7.5 and 7.6 of *Simulation of Leaping, Tumbling, Landing, and Balancing Humans*, for an upright pelvis and
    a flat foot; a longer distance than the leg has stretches it.

    Args:
        leg: As `body.leg_geometry` gives it.
        length: From hip to ankle [m].
    """
    bend, lean = _triangle(leg, length)
    # The angles are counted from the reference pose, where thigh and shank lean a little.
    return leg.thigh_lean - lean, bend - leg.thigh_lean + leg.shank_lean, lean - bend - leg.shank_lean


def _triangle(leg: LegGeometry, length: float) -> tuple[float, float]:
    """Bend of the knee, and angle of the thigh from the line to the ankle [rad], both positive."""
    thigh, shank = leg.thigh, leg.shank
    length = min(max(length, abs(thigh - shank) + 1e-6), thigh + shank)
    at_knee = (thigh**2 + shank**2 - length**2) / (2.0 * thigh * shank)
    at_hip = (thigh**2 - shank**2 + length**2) / (2.0 * thigh * length)
    return float(np.pi - np.arccos(np.clip(at_knee, -1.0, 1.0))), float(np.arccos(np.clip(at_hip, -1.0, 1.0)))
