"""Rigid bodies that can be touched, alone in space, and two of them that meet, in float64."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.warp_kernels.bumper import bumper_of
from echelon.warp_kernels.character import NO_EVENT, Capsule, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.meeting import GHOST_MOTION, PAIR_MEMORY, UNDECIDED, Bumper, Law
from echelon.warp_kernels.meeting_code import contact_frequency
from echelon.warp_kernels.model import Joint, Link, Vec3
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceMeeting, ReferenceRun
from echelon.warp_kernels.restitution import restitution_damping
from echelon.warp_kernels.spatial import quaternion_matrix

STEP = 1.0 / 720.0
SUBSTEPS = 24
BALL = (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.25),)
ROD = (Capsule((-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), 0.15),)


class FreeBody:
    """One rigid link without contact sites, as a `Character`; no gravity unless asked for."""

    name: str = "free-body"
    commands: tuple[str, ...] = ()
    phase_names: tuple[str, ...] = ("free",)
    events: tuple[str, ...] = ()
    records: tuple[str, ...] = ()
    parameters: Mapping[str, float] = {}
    memory: Mapping[str, float] = {"phase": 0.0, "fallen": 0.0, "loaded": 1.0}
    steps_per_second: int = 720
    steps_per_tick: int = 6

    def __init__(
        self,
        mass: float = 10.0,
        moments: Vec3 = (0.4, 0.4, 0.4),
        capsules: tuple[Capsule, ...] = BALL,
        center: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:
        inertia = ((moments[0], 0.0, 0.0), (0.0, moments[1], 0.0), (0.0, 0.0, moments[2]))
        link = Link("link", None, Joint("root", "free"), mass, com=center, inertia=inertia)
        self.body = Body(name=self.name, links=(link,), gravity=0.0)
        self.capsules = capsules

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """All in the reference pose."""
        return Population(np.tile(self.body.q_reference, (count, 1)), np.zeros((count, 6)), {}, {})

    def control(self, view: View) -> None:
        """Nothing to decide."""

    def actuate(self, view: View, joints: JointForces) -> None:
        """Nothing to push."""


def rod(mass: float = 10.0, center: Vec3 = (0.0, 0.0, 0.0)) -> FreeBody:
    """A long body that is easily set spinning."""
    return FreeBody(mass, (0.01 * mass, 0.05 * mass, 0.055 * mass), ROD, center)


def touchable(character: FreeBody) -> Bumper:
    """Its bumper."""
    bumper = bumper_of(character, STEP)
    assert bumper is not None
    return bumper


@dataclass
class Encounter:
    """What became of two bodies, case by case.

    Attributes:
        bodies: The two.
        q, u: Of each, look by look (each substep), shape [looks, cases, 7] and [looks, cases, 6].
    """

    bodies: tuple[FreeBody, FreeBody]
    q: tuple[np.ndarray, np.ndarray]
    u: tuple[np.ndarray, np.ndarray]

    def momentum(self, side: int) -> np.ndarray:
        """Linear momentum of one of them [kg m/s], shape [looks, cases, 3]."""
        return self.bodies[side].body.momentum(self.q[side], self.u[side])[..., :3]

    def impulse(self, side: int) -> np.ndarray:
        """What one of them got from the other [N s], shape [cases, 3]."""
        momentum = self.momentum(side)
        return momentum[-1] - momentum[0]

    @property
    def energy(self) -> np.ndarray:
        """Of both, in motion [J], shape [looks, cases]."""
        first, second = (b.body.energy(q, u)[..., 0] for b, q, u in zip(self.bodies, self.q, self.u, strict=True))
        return first + second


def meet_in_space(
    bodies: tuple[FreeBody, FreeBody],
    q: tuple[np.ndarray, np.ndarray],
    u: tuple[np.ndarray, np.ndarray],
    *,
    restitution: float | np.ndarray = 0.3,
    friction: float | np.ndarray = 0.3,
    frames: int = 6,
) -> Encounter:
    """Each simulated on its own beside the other's ghost, which is set anew where a frame begins.

    Args:
        bodies: Who.
        q, u: How they start, shapes [cases, 7] and [cases, 6].
        restitution, friction: One, or one a case.
        frames: How many.
    """
    cases = len(q[0])
    omega = contact_frequency(STEP)
    wanted = np.broadcast_to(restitution, (cases,))
    damping = np.array([restitution_damping(float(e), omega * STEP) for e in wanted])
    law = Law(omega, damping, np.broadcast_to(friction, (cases,)))
    bumpers = [touchable(body) for body in bodies]
    runs = [ReferenceRun(body, q[i], u[i], step=STEP, tick=6) for i, body in enumerate(bodies)]
    looks_q: list[list[np.ndarray]] = [[run.q] for run in runs]
    looks_u: list[list[np.ndarray]] = [[run.u] for run in runs]
    for _ in range(frames):
        last = [run.meeting.ghosts[0] if run.meeting is not None else None for run in runs]
        # What one keeps of the other's ghost is kept by the one.
        ghosts = [ghost_of(bumpers[i], run.q, run.u, last[1 - i]) for i, run in enumerate(runs)]
        for i, run in enumerate(runs):
            run.meeting = ReferenceMeeting(bumpers[i], law, [ghosts[1 - i]], np.full(cases, NO_EVENT), bumpers[1 - i])
            for _ in range(SUBSTEPS):
                run.substep()
                looks_q[i].append(run.q)
                looks_u[i].append(run.u)
    found_q, found_u = (tuple(np.stack(looks) for looks in both) for both in (looks_q, looks_u))
    return Encounter(bodies, (found_q[0], found_q[1]), (found_u[0], found_u[1]))


def ghost_of(
    bumper: Bumper, q: np.ndarray, u: np.ndarray, before: Sequence[np.ndarray] | None = None
) -> list[np.ndarray]:
    """The numbers of a ghost for each of several states, its gravity off; `before` were those a frame ago."""
    rotation = quaternion_matrix([q[:, 3 + i] for i in range(4)])
    turn = np.array([[np.broadcast_to(x, len(q)) for x in row] for row in rotation]).transpose(2, 0, 1)
    arm = turn @ np.array(bumper.center)
    spin = (turn @ u[:, 3:6, None])[..., 0]
    place, velocity = q[:, :3] + arm, u[:, :3] + np.cross(spin, arm)
    motion = np.concatenate(
        [
            place,
            q[:, 3:7],
            velocity,
            u[:, 3:6],
            np.zeros((len(q), 1)),
            np.full((len(q), 1), -1e9),
            np.zeros((len(q), 3)),
        ],
        1,
    )
    assert motion.shape[1] == GHOST_MOTION
    numbers = [motion[:, i].copy() for i in range(GHOST_MOTION)]
    for pair in range(bumper.pair_count):
        at_pressed = GHOST_MOTION + PAIR_MEMORY * pair + 2
        pressed = np.zeros(len(q)) if before is None else before[at_pressed]
        numbers += [np.full(len(q), UNDECIDED), np.zeros(len(q)), pressed]
    return numbers


def at(
    places: np.ndarray, velocities: np.ndarray, spins: np.ndarray | float = 0.0, yaw: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """q and u of bodies at places [m] that move [m/s] and spin about their own axes [rad/s], turned about z [rad]."""
    place, velocity = np.atleast_2d(np.array(places, dtype=float)), np.atleast_2d(np.array(velocities, dtype=float))
    count = len(place)
    q, u = np.zeros((count, 7)), np.zeros((count, 6))
    q[:, :3], u[:, :3] = place, velocity
    half = 0.5 * np.broadcast_to(np.asarray(yaw, dtype=float), (count,))
    q[:, 5], q[:, 6] = np.sin(half), np.cos(half)
    u[:, 3:] = np.broadcast_to(np.asarray(spins, dtype=float), (count, 3))
    return q, u
