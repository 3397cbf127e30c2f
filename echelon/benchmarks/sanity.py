"""Whether a run was sane: a rate counts only if what was computed so fast was physics.

The same questions are put to every engine, on states in our coordinates and in float64:

* is everything finite, and is every quaternion of unit length;
* **in flight**, where only gravity acts from outside: did angular momentum about the centre of mass stay (relative to
  the start, a second), and did kinetic energy about the centre of mass plus the springs' never rise above the start's;
* **hopping**: has nobody fallen, and is everybody's mean speed what it should be;
* **set down on the ground without control**: has it not fallen, and did its energy never rise above the start's;
* **riding**: is everybody upright on a straight road, is the speed held, are hands on the bars and feet on the pedals;
* **rolling without control**, for as long as a bicycle stays up by itself: is it upright, on both wheels, do they roll
  and not slide, are hands and feet where they belong, and did its energy never rise above the start's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from echelon.warp_kernels.model import AXIS_COUNT
from echelon.warp_kernels.reference import Body

UNIT_TOLERANCE = 1e-3
"""How far from 1 the length of a quaternion may be."""
SPEED_LIMIT = 0.15
"""How far from what is wanted the mean velocity of a hopper may be [m/s]."""
MOMENTUM_LIMIT = 0.02
"""Relative change of angular momentum in flight [1/s]."""
ENERGY_LIMIT = 0.01
"""By how much of a stated scale an energy that can only fall may rise."""
UPRIGHT_COSINE = 0.5
"""Of the tilt at which what stands counts as fallen: 60 degrees."""
RIDING_SPEED_LIMIT = 0.3
"""How far from what is wanted the speed of a rider may be, at any time [m/s]."""
LEAN_LIMIT = math.radians(5.0)
"""How far a rider may lean who goes straight ahead [rad]."""
GAP_LIMIT = 0.01
"""How far a hand may be from its grip, and a foot from its pedal [m]."""
SLIP_LIMIT = 0.1
"""How much faster or slower than the ground beneath it a wheel may turn [m/s]."""
BEARING_LEAST = 0.95
"""Least part of the time in which both wheels of a bicycle bear."""


@dataclass(frozen=True)
class Verdict:
    """Whether a run was sane.

    Attributes:
        sane: Whether its rate counts.
        why: One line: what was found, or what is wrong.
    """

    sane: bool
    why: str


def fault_of_states(body: Body, q: np.ndarray, u: np.ndarray) -> str:
    """What is wrong with states as such, shapes [agents, q_count] and [agents, u_count]; empty if nothing."""
    lost = ~(np.isfinite(q).all(axis=-1) & np.isfinite(u).all(axis=-1))
    if lost.any():
        return f"{np.count_nonzero(lost)} of {len(q)} states are not finite"
    for index, link in enumerate(body.links):
        if link.joint.kind in ("free", "ball"):
            first = body.q_start(index) + (3 if link.joint.kind == "free" else 0)
            length = np.linalg.norm(q[:, first : first + 4], axis=-1)
            off = float(np.max(np.abs(length - 1.0)))
            if off > UNIT_TOLERANCE:
                return f"the quaternion of joint {link.joint.name!r} is {off:.2g} off unit length"
    return ""


def judge_hopping(
    body: Body, q: np.ndarray, u: np.ndarray, fallen: np.ndarray, frozen: np.ndarray, error: np.ndarray
) -> Verdict:
    """Of hoppers under control.

    Args:
        body: Their body.
        q, u: States at the end, shapes [agents, q_count] and [agents, u_count].
        fallen, frozen: Who fell, whose state stopped being finite, shape [agents], bool.
        error: Distance of each one's mean velocity from the wanted one [m/s], shape [agents].
    """
    if frozen.any():
        return Verdict(False, f"{np.count_nonzero(frozen)} of {len(frozen)} agents' states stopped being finite")
    if fallen.any():
        return Verdict(False, f"{np.count_nonzero(fallen)} of {len(fallen)} agents fell")
    fault = fault_of_states(body, q, u)
    if fault:
        return Verdict(False, fault)
    worst = float(np.max(error))
    found = f"worst error of mean velocity {worst:.3f} m/s"
    if worst > SPEED_LIMIT:
        return Verdict(False, f"{found}, more than {SPEED_LIMIT:g}")
    return Verdict(True, f"nobody fell, {found}")


def judge_flight(
    body: Body, samples: Sequence[tuple[np.ndarray, np.ndarray]], seconds: float, stiffness: float
) -> Verdict:
    """Of a body in free flight, a spring of the same stiffness at each joint.

    Args:
        body: The body.
        samples: (q, u) from start to end, at least two, shapes [agents, q_count] and [agents, u_count].
        seconds: From the first sample to the last [s].
        stiffness: [N m/rad or N/m].
    """
    for q, u in samples:
        fault = fault_of_states(body, q, u)
        if fault:
            return Verdict(False, fault)
    before = body.momentum(*samples[0])[:, 3:]
    change = np.linalg.norm(body.momentum(*samples[-1])[:, 3:] - before, axis=-1)
    drift = float(np.max(change / np.linalg.norm(before, axis=-1))) / seconds
    energies = np.stack([_inner_energy(body, q, u, stiffness) for q, u in samples])
    rise = float(np.max(energies / energies[0])) - 1.0
    found = f"angular momentum drifts {100 * drift:.2g} % a second"
    if drift > MOMENTUM_LIMIT:
        return Verdict(False, f"{found}, more than {100 * MOMENTUM_LIMIT:g} %")
    if rise > ENERGY_LIMIT:
        return Verdict(False, f"energy rises by {100 * rise:.2g} % of the start's, more than {100 * ENERGY_LIMIT:g} %")
    return Verdict(True, f"{found}, energy does not rise")


def judge_standing(body: Body, q: np.ndarray, u: np.ndarray, stiffness: np.ndarray, loaded: float) -> Verdict:
    """Of one body that was set down on the ground and is left to the springs of its joints.

    Args:
        body: The body; its first link is the one that must stay upright.
        q, u: Every step's state from start to end, shapes [steps, q_count] and [steps, u_count].
        stiffness: Of every coordinate's spring about zero [N m/rad or N/m], shape [q_count].
        loaded: Part of the steps in which it touched the ground.
    """
    fault = fault_of_states(body, q, u)
    if fault:
        return Verdict(False, fault)
    x, y = q[:, 3], q[:, 4]
    if float(np.min(1.0 - 2.0 * (x * x + y * y))) < UPRIGHT_COSINE:
        return Verdict(False, "it fell")
    if loaded == 0.0:
        return Verdict(False, "it never touched the ground")
    energy = body.energy(q, u).sum(axis=-1) + 0.5 * (q * q) @ stiffness
    # Against what lifting it by its own height takes.
    rise = float(np.max(energy - energy[0])) / (body.mass * body.gravity * float(q[0, 2]))
    if rise > ENERGY_LIMIT:
        return Verdict(False, f"energy rises by {100 * rise:.2g} % of weight times height")
    return Verdict(True, f"touches the ground in {100 * loaded:.0f} % of steps, energy does not rise")


def judge_riding(
    body: Body,
    q: np.ndarray,
    u: np.ndarray,
    fallen: np.ndarray,
    frozen: np.ndarray,
    speed_error: np.ndarray,
    lean: np.ndarray,
    gap: np.ndarray,
) -> Verdict:
    """Of riders under control on a straight road.

    Args:
        body: Rider and bicycle.
        q, u: States at the end, shapes [agents, q_count] and [agents, u_count].
        fallen, frozen: Who fell, whose state stopped being finite, shape [agents], bool.
        speed_error: Largest difference of each one's speed from the wanted one [m/s], shape [agents].
        lean: Largest of each one, to either side [rad], shape [agents].
        gap: Largest distance of a hand or foot from where it belongs [m], shape [agents].
    """
    if frozen.any():
        return Verdict(False, f"{np.count_nonzero(frozen)} of {len(frozen)} agents' states stopped being finite")
    if fallen.any():
        return Verdict(False, f"{np.count_nonzero(fallen)} of {len(fallen)} riders fell")
    fault = fault_of_states(body, q, u) or _fault_of_seat(float(np.max(lean)), float(np.max(gap)))
    if fault:
        return Verdict(False, fault)
    worst = float(np.max(speed_error))
    found = f"worst error of speed {worst:.2f} m/s"
    if worst > RIDING_SPEED_LIMIT:
        return Verdict(False, f"{found}, more than {RIDING_SPEED_LIMIT:g}")
    return Verdict(True, f"nobody fell, {found}, hands and feet on within {1e3 * float(np.max(gap)):.1f} mm")


def judge_rolling(
    body: Body, q: np.ndarray, u: np.ndarray, spring_energy: np.ndarray, bearing: float, gap: float, slip: float
) -> Verdict:
    """Of one rider who was set rolling and is left to the springs of the joints.

    Args:
        body: Rider and bicycle; the first link is the frame.
        q, u: Every step's state from start to end, shapes [steps, q_count] and [steps, u_count].
        spring_energy: What the joints' springs hold at every step [J], shape [steps].
        bearing: Part of the steps in which both wheels touched the ground.
        gap: Largest distance of a hand or foot from where it belongs [m].
        slip: Largest difference between the speed of a wheel's rim and that of the bicycle [m/s].
    """
    fault = fault_of_states(body, q, u) or _fault_of_seat(float(np.max(np.abs(lean_of(q[:, 3:7])))), gap)
    if fault:
        return Verdict(False, fault)
    if bearing < BEARING_LEAST:
        return Verdict(False, f"both wheels bear in {100 * bearing:.0f} % of steps, fewer than {100 * BEARING_LEAST:g}")
    if slip > SLIP_LIMIT:
        return Verdict(False, f"a wheel slips by {slip:.2f} m/s, more than {SLIP_LIMIT:g}")
    energies = body.energy(q, u)
    rise = float(np.max(energies.sum(axis=-1) + spring_energy - energies[0].sum() - spring_energy[0]))
    if rise > ENERGY_LIMIT * float(energies[0, 0]):
        return Verdict(
            False, f"energy rises by {100 * rise / float(energies[0, 0]):.2g} % of the motion's at the start"
        )
    return Verdict(
        True, f"upright, rolls without sliding, hands and feet on within {1e3 * gap:.1f} mm, energy does not rise"
    )


def _fault_of_seat(lean: float, gap: float) -> str:
    """What is wrong with how a rider sits: the largest lean [rad] and gap [m]; empty if nothing."""
    if not lean <= LEAN_LIMIT:
        return f"a rider leans by {math.degrees(lean):.1f} degrees, more than {math.degrees(LEAN_LIMIT):g}"
    if not gap <= GAP_LIMIT:
        return f"a hand or foot is {1e3 * gap:.1f} mm from where it belongs, more than {1e3 * GAP_LIMIT:g}"
    return ""


def lean_of(orientation: np.ndarray) -> np.ndarray:
    """Lean to the right against gravity [rad] of frames with these quaternions (x, y, z, w), shape [..., 4]."""
    x, y, z, w = np.moveaxis(orientation, -1, 0)
    return np.arcsin(np.clip(2.0 * (y * z + x * w), -1.0, 1.0))


def spring_gaps(body: Body, poses: np.ndarray) -> np.ndarray:
    """Distance between the ends of each of a body's springs between links [m].

    Args:
        body: The body.
        poses: Link poses, shape [..., links, 7].

    Returns:
        Shape [..., springs].
    """
    gaps = []
    for spring in body.springs:
        ends = ((spring.link_a, spring.position_a), (spring.link_b, spring.position_b))
        a, b = (_in_world(body, poses, link, np.array(position)) for link, position in ends)
        gaps.append(np.linalg.norm(a - b, axis=-1))
    return np.stack(gaps, axis=-1)


def _in_world(body: Body, poses: np.ndarray, link: str | None, point: np.ndarray) -> np.ndarray:
    """A point of a link in the world [m], shape [..., 3]."""
    if link is None:
        return np.broadcast_to(point, (*poses.shape[:-2], 3))
    pose = poses[..., body.link_index(link), :].astype(float)
    axis, w = pose[..., 3:6], pose[..., 6:]
    once = np.cross(axis, point)
    return pose[..., :3] + point + 2.0 * (w * once + np.cross(axis, once))


def _inner_energy(body: Body, q: np.ndarray, u: np.ndarray, stiffness: float) -> np.ndarray:
    """Kinetic energy about the centre of mass and what the joints' springs hold [J], shape [agents]."""
    linear = body.momentum(q, u)[:, :3]
    energy = body.energy(q, u)[:, 0] - 0.5 * np.sum(linear * linear, axis=-1) / body.mass
    for index, link in enumerate(body.links):
        first, kind = body.q_start(index), link.joint.kind
        if kind == "ball":
            energy = energy + 4.0 * stiffness * (1.0 - np.abs(q[:, first + 3]))
        for axis in range(AXIS_COUNT[kind]):
            energy = energy + 0.5 * stiffness * q[:, first + axis] ** 2
    return energy
