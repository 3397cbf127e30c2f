"""What a character is to the engine: a body, a memory, and two pieces of control to be traced.

A character's controller runs at two rates. `control` runs once a tick, a whole number of substeps: state machines
move there, and desired angles are computed. `actuate` runs every substep: it turns what control decided into joint
torques, and latches what may not be missed (touchdown, liftoff). Both see a `View` of one agent and are ordinary
Python over scalars (see `trace`): no branches on values, only `select`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from echelon.warp_kernels.contact import Contact, JointForces, strain_count
from echelon.warp_kernels.kinematics import Kinematics
from echelon.warp_kernels.model import Model, Vec3
from echelon.warp_kernels.reference import Body

NO_EVENT = -1.0
"""Value of an event's latch while nothing has happened in this frame."""

LOST, HELD, REMOVED = 1.0, 2.0, 3.0
"""Values of `StateLayout.frozen` of an agent that nothing moves: its state stopped being finite, somebody else says
where it is, or it is no longer there for others to see. Zero for all others."""


@dataclass(frozen=True)
class Capsule:
    """All points nearer than a radius to a line segment.

    Attributes:
        start, end: Of the segment [m].
        radius: [m].
    """

    start: Vec3
    end: Vec3
    radius: float


@dataclass(frozen=True)
class AgentState:
    """The state of an agent as scalars of any kind.

    Attributes:
        q, u: Generalised positions and speeds.
        strains: Of each contact site (see `contact`).
        memory: The controller's variables by name.
        substep: Substep of the frame, from 0.
    """

    q: list[Any]
    u: list[Any]
    strains: list[list[Any]]
    memory: dict[str, Any]
    substep: Any


@dataclass
class View:
    """One agent as its controller sees it.

    Attributes:
        q, u: Generalised positions and speeds.
        kin: Kinematics of every node.
        memory: The controller's own variables by name; assign to change them.
        parameters: What differs between individuals, by name.
        command: What the group layer wants, by name.
        contacts: For each contact site by name what it feels; only while actuating.
        substep: Which substep of the frame this is, counted from 0.
        step: Length of a substep [s].
        tick: Length of a control tick [s].
        implicit_step: The same under semi-implicit Euler, 0 where forces must be plain (Runge-Kutta).
        springs: By name of a spring of the body, what its force is multiplied by; 1 for those that are not named.
            Assign while actuating: 0 lets go.
        pushes: By name of a link, force [N] along the world's axes that acts at its centre of mass. Assign while
            actuating.
    """

    q: Sequence[Any]
    u: Sequence[Any]
    kin: Kinematics
    memory: dict[str, Any]
    parameters: Mapping[str, Any]
    command: Mapping[str, Any]
    substep: Any
    step: float
    tick: float
    implicit_step: float
    contacts: Mapping[str, Contact] = field(default_factory=dict)
    springs: dict[str, Any] = field(default_factory=dict)
    pushes: dict[str, Sequence[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Population:
    """The individuals of a crowd as they start.

    Attributes:
        q: Generalised positions, a free root's relative to the agent's place on the ground, shape [agents, q_count].
        u: Generalised speeds, shape [agents, u_count].
        parameters: What differs between them, by name, shape [agents] each.
        memory: Where their controllers' memory differs from the usual, by name, shape [agents] each.
    """

    q: np.ndarray
    u: np.ndarray
    parameters: Mapping[str, np.ndarray]
    memory: Mapping[str, np.ndarray]


class Character(Protocol):
    """A body with a controller.

    A character that others can touch also has `capsules`, `Capsule`s in the axes of its first link (see `meeting`). One
    that remembers heights also has `heights`, the names of those memory variables: they are counted from the floating
    origin, and move with it.

    Attributes:
        name: As scenarios call it.
        body: What it is made of.
        memory: Names and initial values of the controller's variables. It must hold `phase` (an index into
            `phase_names`), `fallen` (0 or 1) and `loaded` (0 or 1: a foot carries weight).
        parameters: Names and usual values of what may differ between individuals.
        commands: Names of what the group layer hands in once a frame.
        phase_names: Names of the controller's phases.
        events: Names of memory variables that are `NO_EVENT` at the start of each frame and take the substep at
            which their event happened.
        records: Names of memory variables that recordings keep, as measures.
        steps_per_second: At least so many substeps a second its dynamics and control need [1/s].
        steps_per_tick: Substeps between two decisions that suit it.
    """

    name: str
    body: Body
    memory: Mapping[str, float]
    parameters: Mapping[str, float]
    commands: tuple[str, ...]
    phase_names: tuple[str, ...]
    events: tuple[str, ...]
    records: tuple[str, ...]
    steps_per_second: int
    steps_per_tick: int

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Individuals that differ by about `variation`, ready to start; agent i does not depend on the count."""
        ...

    def control(self, view: View) -> None:
        """Decide, once a tick: assign to ``view.memory``."""
        ...

    def actuate(self, view: View, joints: JointForces) -> None:
        """Push, every substep: add to ``joints``, latch in ``view.memory``."""
        ...


@dataclass(frozen=True)
class StateLayout:
    """Where each variable stands in an agent's state: q, u, strains, memory, bookkeeping.

    Attributes:
        q, u: Indices of the first coordinate and speed.
        strain: Index of the first strain of each contact site, by place in the model's list.
        memory: Index of each memory variable by name.
        substep: Index of the substep counter.
        frozen: Index of the flag of an agent that stays as it is (see `LOST`).
        size: Number of variables.
        touch: Index of the substep in which another was touched first in this frame (`NO_EVENT` if nobody was), and
            after it that of the frame before; None for those who touch nobody.
    """

    q: int
    u: int
    strain: tuple[int, ...]
    memory: Mapping[str, int]
    substep: int
    frozen: int
    size: int
    touch: int | None = None

    @classmethod
    def of(cls, model: Model, memory: Mapping[str, float], meets: bool = False) -> StateLayout:
        """The layout for a model and a controller's memory, of a character that meets others or does not."""
        u = model.q_count
        at = u + model.u_count
        strain: list[int] = []
        for site in model.contacts:
            strain.append(at)
            at += strain_count(site)
        places = {name: at + i for i, name in enumerate(memory)}
        at += len(places)
        if meets:
            return cls(0, u, tuple(strain), places, at, at + 1, at + 4, at + 2)
        return cls(0, u, tuple(strain), places, at, at + 1, at + 2)
