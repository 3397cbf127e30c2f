"""What others meet of a character: capsules on its first link, and how easily a blow sets it in motion.

A neighbour meets a character as one rigid body (`meeting`). How heavy that body is depends on where it is struck: on a
rider's shoulder hang trunk and frame, on the end of the front wheel almost nothing; and on how long the blow lasts:
legs on loose joints stay behind at first, springs and servos bring them along. So the *apparent mobility* is measured
where it matters, over the time that a contact takes: the character, as it usually moves, is run in float64 with and
without a blow of that length on its first link, once for each of six directions; what the link's velocity has changed
by, per unit of blow, is a column of a 6 x 6 matrix. Of a single rigid link it is diag(1/m, I^-1).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from echelon.warp_kernels.character import Capsule, Character
from echelon.warp_kernels.meeting import CONTACT_TIME, MOBILITY_SIZE, Bumper
from echelon.warp_kernels.reference_run import ReferenceRun
from echelon.warp_kernels.spatial import quaternion_matrix

BLOW_SPEED = 0.3
"""Blows that are tried would set the whole mass in motion so fast [m/s]."""

LEAST_SHARE = 0.02
"""No direction of an apparent mobility is stiffer than this part of the whole character's mass would make it."""


@lru_cache(maxsize=32)
def bumper_of(character: Character, step: float) -> Bumper | None:
    """What others meet of a character, None of one that has no capsules.

    Args:
        character: Who.
        step: Length of a substep, over which its blows are tried [s].
    """
    capsules: tuple[Capsule, ...] = tuple(getattr(character, "capsules", ()))
    if not capsules:
        return None
    body = character.body
    if body.links[0].joint.kind != "free":
        raise ValueError(f"character {character.name!r}: capsules need a first link that moves freely")
    people = character.population(1, 0, 0.0, True)
    mass = body.mass
    center = body.center_of_mass(people.q)[0] - people.q[0, :3]
    turn = np.array(quaternion_matrix(list(people.q[0, 3:7])))
    center = turn.T @ center
    mobility = _rounded(_apparent_mobility(character, people.q, people.u, center, turn, mass, step))
    spin_inertia = _rounded(np.linalg.inv(mobility[3:, 3:]))
    x, y, z = (float(c) for c in np.round(center, 6))
    ends = np.array([[capsule.start, capsule.end] for capsule in capsules]) - (x, y, z)
    radii = np.array([capsule.radius for capsule in capsules])
    reach = float((np.linalg.norm(ends, axis=-1).max(axis=-1) + radii).max())
    return Bumper(
        capsules,
        (x, y, z),
        _rows(mobility),
        _rows(spin_inertia),
        reach,
        float(radii.max()),
    )


def _apparent_mobility(
    character: Character, q: np.ndarray, u: np.ndarray, center: np.ndarray, turn: np.ndarray, mass: float, step: float
) -> np.ndarray:
    """Response of the first link to blows about the centre of mass, in the link's axes, shape [6, 6]."""
    count = max(round(CONTACT_TIME / step), 1)
    share = np.sin(np.pi * (np.arange(count) + 0.5) / count)
    share /= share.sum() * step
    composite = _composite_inertia(character, q)
    scale = np.concatenate([np.full(3, mass), np.full(3, np.trace(composite) / 3.0)]) * BLOW_SPEED
    blows = np.concatenate([np.zeros((1, MOBILITY_SIZE)), np.diag(scale)])
    moments = blows[:, 3:] + np.cross(center, blows[:, :3])  # about the link's origin
    names = character.commands[:2]
    command = dict(zip(names, (float(u[0, 0]), float(u[0, 1])), strict=False)) if "velocity_x" in names else {}
    copies = [np.repeat(values, len(blows), axis=0) for values in (q, u)]
    run = ReferenceRun(character, *copies, step=step, tick=character.steps_per_tick, command=command)
    for substep in range(count):
        if substep % run.tick == 0:
            run.control()
        wrench = np.concatenate([moments, blows[:, :3]], axis=1) * share[substep]
        run.wrench = [wrench[:, i] for i in range(MOBILITY_SIZE)]
        run.substep()
    change = run.u[1:, :6] - run.u[:1, :6]
    spins = change[:, 3:]
    linear = change[:, :3] @ turn + np.cross(spins, center)
    response = np.concatenate([linear, spins], axis=1).T / scale
    return _definite(0.5 * (response + response.T), np.concatenate([np.full(3, mass), np.diag(composite)]))


def _composite_inertia(character: Character, q: np.ndarray) -> np.ndarray:
    """Moments of inertia of the whole, stiffened, about its centre of mass, in the world's axes [kg m^2]."""
    body = character.body
    center, total = body.center_of_mass(q)[0], np.zeros((3, 3))
    for link, pose in zip(body.links, body.link_poses(q)[0], strict=True):
        turn = np.array(quaternion_matrix(list(pose[3:])))
        arm = pose[:3] + turn @ np.array(link.com) - center
        total += turn @ np.array(link.inertia) @ turn.T + link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total


def _definite(mobility: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """The nearest matrix by which every blow sets something in motion, at least a little."""
    # In units in which the whole character, stiffened, would have the identity.
    scale = np.sqrt(inertia)
    values, vectors = np.linalg.eigh(mobility * np.outer(scale, scale))
    return (vectors * np.maximum(values, LEAST_SHARE)) @ vectors.T / np.outer(scale, scale)


def _rounded(matrix: np.ndarray) -> np.ndarray:
    """To six digits of the largest entry of each block's row: libraries of linear algebra differ beyond."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    unit = np.outer(size, size)
    return np.round(matrix / unit, 6) * unit.astype(np.float32).astype(float)


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(entry) for entry in row) for row in matrix)
