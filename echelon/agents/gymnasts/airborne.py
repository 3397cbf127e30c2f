"""Gymnasts who start in the air: in a position, at a speed, with an angular momentum that is theirs to keep.

What they do in flight, and how they land, can so be tried without a leap before it, as chapters 5 and 6 of *Simulation
of Leaping, Tumbling, Landing, and Balancing Humans* do for tumbles and landings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from echelon.agents.gymnasts.channels import CHANNELS
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.poses import inertia_tensor
from echelon.agents.gymnasts.posture import channels_of, positions_of
from echelon.agents.gymnasts.standing import sole_points
from echelon.warp_kernels.character import Population

LONG_AGO = 10.0
"""For so long those who start in the air have felt no ground [s]."""


def airborne_population(
    character: Gymnast,
    channels: Mapping[str, float],
    count: int = 1,
    *,
    height: float = 100.0,
    velocity: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    momentum: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> Population:
    """Upright gymnasts in the air whose joints are where they should be and at rest.

    Args:
        character: Who.
        channels: Their position, as of `poses` [rad].
        count: How many.
        height: Of the centre of mass over the ground at z = 0 [m].
        velocity: Of the centre of mass [m/s], shape [3] or [count, 3].
        momentum: Angular momentum about the centre of mass [kg m^2/s], shape [3] or [count, 3].

    Returns:
        Them, above the world's origin, their memory as of somebody who left the ground long ago.
    """
    body = character.body
    q = positions_of(body, channels)
    center = body.center_of_mass(q) - q[:3]
    q[:3] = [0.0, 0.0, height] - center
    omega = np.broadcast_to(momentum, (count, 3)) @ np.linalg.inv(inertia_tensor(body, q)).T
    u = np.zeros((count, body.u_count))
    # The root's origin turns about the centre of mass; it stands upright, so its axes are the world's.
    u[:, :3] = np.broadcast_to(velocity, (count, 3)) + np.cross(omega, -center)
    u[:, 3:6] = omega
    angles = channels_of(body, q) | dict(channels)
    memory = character.remembering({channel: np.full(count, value) for channel, value in angles.items()})
    for name, value in (("loaded", 0.0), ("unloaded", LONG_AGO), ("hands_unloaded", LONG_AGO)):
        memory[name] = np.full(count, value)
    return Population(q=np.tile(q, (count, 1)), u=u, parameters={}, memory=memory)


def in_the_air(
    character: Gymnast, table: np.ndarray, speeds: np.ndarray, *, falls: np.ndarray | None = None, height: float = 0.0
) -> Population:
    """Gymnasts in the posture of a table's first row, above the ground.

    Args:
        character: Who.
        table: Of a script, shape [rows, row size].
        speeds: Forward [m/s], shape [agents].
        falls: How high their soles are [m], shape [agents]; None where the centre of mass counts.
        height: Of the centre of mass [m], where `falls` is None.
    """
    body = character.body
    targets = np.nan_to_num(table[0, : len(CHANNELS)].astype(np.float64))
    channels = dict(zip(CHANNELS, targets.tolist(), strict=True))
    q = np.tile(positions_of(body, channels), (len(speeds), 1))
    soles = sole_points(body, q[0])[:, 2].min()
    q[:, 2] += height - body.center_of_mass(q[0])[2] if falls is None else falls - soles
    u = np.zeros((len(speeds), body.u_count))
    u[:, 0] = speeds
    memory = character.remembering({name: np.full(len(speeds), value) for name, value in channels.items()})
    return Population(q=q, u=u, parameters={}, memory=memory)
