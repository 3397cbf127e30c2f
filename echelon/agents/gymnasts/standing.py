"""How a gymnast stands at ease, and where the points are with which it touches the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from echelon.agents.gymnasts.body import FOOT_SITES, TOE_SITES
from echelon.agents.gymnasts.joints import SIDES, position_index
from echelon.errors import InputError
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.spatial import quaternion_normalized


def standing_q(body: Body, *, knee_flexion: float = 0.0, arms: float = 1.35, lean: float = 0.0) -> np.ndarray:
    """Standing at ease: both soles flat on z = 0, the centre of mass over the middle of the feet.

    Trunk and head stay upright; the thighs' angle, made up for at the ankles, brings the pelvis forward or back. The
    origin lies beneath the pelvis.

    Args:
        body: A gymnast's body.
        knee_flexion: Angle of the knees [rad].
        arms: By how much the arms are lowered from the reference pose's T [rad]; pi/2 hangs them straight down.
        lean: Wanted centre of mass, forward of the middle between heel and tip [m].

    Returns:
        Generalised positions, shape [q_count].

    Raises:
        InputError: The legs cannot bring the centre of mass there.
    """
    q = body.q_reference
    for side, sign in (("left", -1.0), ("right", 1.0)):
        q[position_index(body, f"{side}_knee", "y")] = knee_flexion
        link = body.link_index(f"{side}_upper_arm")
        start = body.q_start(link)
        if body.links[link].joint.kind == "ball":
            q[start : start + 4] = (math.sin(0.5 * sign * arms), 0.0, 0.0, math.cos(0.5 * sign * arms))
        else:
            q[start] = sign * arms
    hips = [position_index(body, f"{side}_hip", "y") for side in SIDES]
    ankles = [position_index(body, f"{side}_ankle", "y") for side in SIDES]
    low, high = -2.0, 0.8
    for _ in range(60):  # halving a range of 2.8 rad leaves nothing of it
        hip = 0.5 * (low + high)
        q[hips], q[ankles] = hip, -(hip + knee_flexion)
        # The hips go forward, with all that they carry, as the thighs turn backward.
        if _ahead_of_feet(body, q) - lean > 0.0:
            high = hip
        else:
            low = hip
    if abs(_ahead_of_feet(body, q) - lean) > 1e-6:
        raise InputError(f"gymnast: cannot stand with knees at {knee_flexion} rad and the weight {lean} m forward")
    feet = sole_points(body, q)
    q[0] -= body.link_poses(q)[body.link_index("pelvis"), 0]
    q[2] -= feet[:, 2].min()
    return q


def sole_middle(body: Body, q: np.ndarray) -> np.ndarray:
    """Middle of the box around all points of both soles [m], world axes, shape [3]."""
    points = sole_points(body, q)
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _ahead_of_feet(body: Body, q: np.ndarray) -> float:
    return float(body.center_of_mass(q)[0] - sole_middle(body, q)[0])


def sole_points(body: Body, q: np.ndarray) -> np.ndarray:
    """The points of both soles in the world [m], shape [points, 3]."""
    names = {name for sites in (FOOT_SITES, TOE_SITES) for of_side in sites.values() for name in of_side}
    return np.array([point for name, point in site_points(body, q).items() if name in names])


def site_points(body: Body, q: np.ndarray) -> dict[str, np.ndarray]:
    """Centre of every contact site in the world [m], each of shape [3]."""
    poses = body.link_poses(q)
    return {
        site.name: _turned(poses[body.link_index(site.link), 3:], site.position) + poses[body.link_index(site.link), :3]
        for site in body.contacts
    }


def _turned(quaternion: np.ndarray, vector: Sequence[float]) -> np.ndarray:
    x, y, z, w = quaternion_normalized(list(quaternion))
    axis, v = np.array([x, y, z], dtype=float), np.asarray(vector, dtype=float)
    across = 2.0 * np.cross(axis, v)
    return v + w * across + np.cross(axis, across)
