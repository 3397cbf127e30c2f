"""The frame loop in float64 NumPy: the same controller, contacts and dynamics, to be stepped through in a debugger.

It calls the functions that are traced into native code, in the same order; what differs is the arithmetic. The lanes
are tested against it, and `probes.divergence_of_lanes` says where the two part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.warp_kernels.character import NO_EVENT, AgentState, Character, View
from echelon.warp_kernels.contact import strain_count
from echelon.warp_kernels.integrate import position_rate, semi_implicit_positions, wrapped_positions
from echelon.warp_kernels.kinematics import kinematics
from echelon.warp_kernels.meeting import Bumper, Law
from echelon.warp_kernels.meeting_code import meet
from echelon.warp_kernels.program import Integrator, SubstepResult, evaluate_substep
from echelon.warp_kernels.script_reference import arrive_reference
from echelon.warp_kernels.scripts import ScriptLayout
from echelon.warp_kernels.spatial import quaternion_normalized
from echelon.warp_kernels.trace import Probe, record_probes

LEVEL_PLANE = (0.0, 0.0, 1.0, 0.0)
NO_WALL = (1.0, 0.0, 0.0, -1.0e6)


@dataclass(frozen=True)
class Divergence:
    """The first probe at which two computations differ.

    Attributes:
        name, source: Of the probe, and the file and line that it stands on.
        expected, found: Its values in the reference and elsewhere.
    """

    name: str
    source: str
    expected: np.ndarray
    found: np.ndarray


@dataclass
class ReferenceMeeting:
    """Who is beside the agents of a run.

    Attributes:
        bumper: What others meet of the character.
        law: What contacts are like.
        ghosts: The numbers of each agent's ghosts, shape [agents] each, as `meeting_code.meet` takes them.
        touched: Substep of the first touch, or `NO_EVENT`, shape [agents].
        others: The bumper of the ghosts; None if it is the agents'.
    """

    bumper: Bumper
    law: Law
    ghosts: list[list[np.ndarray]]
    touched: np.ndarray
    others: Bumper | None = None


class ReferenceRun:
    """Any number of agents of one character in float64.

    Args:
        character: Who.
        q, u: State to start from, shapes [agents, q_count] and [agents, u_count].
        step: Length of a substep [s].
        tick: Substeps a control tick.
        integrator: "semi-implicit" or "rk4".
        planes: (n_x, n_y, n_z, d) of the plane that each contact site meets [m]; level ground at z = 0 and no walls if
            not given.
        command: Commands by name, one number or one an agent; zero where not given.
        parameters: Parameters by name, likewise; the character's usual ones where not given.
        memory: Where the controllers' memory differs from the usual, by name, likewise.
        scripts: Rows of the scripts of a character that follows any, shape [rows, row size]; `first_row` in memory says
            where an agent's begins.

    Attributes:
        state: As it is now.
        wrench: What pushes the first links in the next substep, six of shape [agents] (see `evaluate_substep`).
        meeting: Who is beside them and pushes them; sets `wrench`.
    """

    def __init__(
        self,
        character: Character,
        q: np.ndarray,
        u: np.ndarray,
        *,
        step: float = 1.0 / 1200.0,
        tick: int = 5,
        integrator: Integrator = "semi-implicit",
        planes: Sequence[Sequence[float]] | None = None,
        command: Mapping[str, float | np.ndarray] | None = None,
        parameters: Mapping[str, float | np.ndarray] | None = None,
        memory: Mapping[str, float | np.ndarray] | None = None,
        scripts: np.ndarray | None = None,
    ) -> None:
        self.character = character
        self.scripts = scripts
        self.step = step
        self.tick = tick
        self.integrator = integrator
        self.agent_count = len(q)
        body = character.body
        usual = [LEVEL_PLANE if site.surface == "ground" else NO_WALL for site in body.contacts]
        self.planes = [list(map(float, plane)) for plane in (usual if planes is None else planes)]
        self.command = {name: self._column((command or {}).get(name, 0.0)) for name in character.commands}
        self.parameters = {
            name: self._column((parameters or {}).get(name, usual)) for name, usual in character.parameters.items()
        }
        self.state = AgentState(
            q=_columns(q),
            u=_columns(u),
            strains=[[self._column(0.0) for _ in range(strain_count(site))] for site in body.contacts],
            memory={name: self._column((memory or {}).get(name, usual)) for name, usual in character.memory.items()},
            substep=self._column(0.0),
        )
        self.wrench: Sequence[np.ndarray] | None = None
        self.meeting: ReferenceMeeting | None = None

    def _column(self, value: float | np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, dtype=float), (self.agent_count,)).copy()

    @property
    def q(self) -> np.ndarray:
        """Generalised positions, shape [agents, q_count]."""
        return np.stack(self.state.q, axis=-1)

    @property
    def u(self) -> np.ndarray:
        """Generalised speeds, shape [agents, u_count]."""
        return np.stack(self.state.u, axis=-1)

    def control(self) -> None:
        """One control tick."""
        state, body = self.state, self.character.body
        kin = kinematics(body.tree, state.q, state.u)
        view = View(
            state.q,
            state.u,
            kin,
            dict(state.memory),
            self.parameters,
            self.command,
            state.substep,
            self.step,
            self.tick * self.step,
            self.step,
        )
        self.character.control(view)
        state.memory.update({name: self._column(value) for name, value in view.memory.items()})

    def evaluate(self, state: AgentState, implicit_step: float, advance: float) -> SubstepResult:
        """Contacts, torques and accelerations of a state (see `evaluate_substep`)."""
        return evaluate_substep(
            self.character,
            state,
            self.parameters,
            self.command,
            self.planes,
            self.step,
            self.tick * self.step,
            implicit_step,
            advance,
            self.wrench,
        )

    def substep(self) -> SubstepResult:
        """One substep; returns what was evaluated at its start."""
        if self.meeting is not None:
            self._meet(self.meeting)
        result = self._semi_implicit() if self.integrator == "semi-implicit" else self._runge_kutta()
        self.state.memory.update({name: self._column(value) for name, value in result.memory.items()})
        self.state = AgentState(
            self.state.q, self.state.u, self.state.strains, self.state.memory, self.state.substep + 1.0
        )
        return result

    def _meet(self, meeting: ReferenceMeeting) -> None:
        """The push of the ghosts as they are, and the ghosts a substep later."""
        q, u = self.state.q, self.state.u
        root = (q[0:3], q[3:7], u[0:3], u[3:6])
        wrench, meeting.ghosts, touching = meet(
            meeting.bumper, meeting.law, self.step, root, meeting.ghosts, meeting.others
        )
        self.wrench = [self._column(value) for value in wrench]
        first = touching & (meeting.touched < 0.0)
        meeting.touched = np.where(first, self.state.substep, meeting.touched)

    def frame(self, substeps: int = 40) -> None:
        """One frame: control every `tick` substeps."""
        for name in self.character.events:
            self.state.memory[name] = self._column(NO_EVENT)
        q = list(self.state.q)
        for place, value in wrapped_positions(self.character.body.tree, q).items():
            q[place] = value
        self.state = AgentState(q, self.state.u, self.state.strains, self.state.memory, self._column(0.0))
        for count in range(substeps):
            if count % self.tick == 0:
                if self.scripts is not None:
                    layout: ScriptLayout = self.character.script  # type: ignore[attr-defined]
                    arrive_reference(layout, self.state.memory, self.scripts)
                self.control()
            self.substep()

    def _semi_implicit(self) -> SubstepResult:
        h, state = self.step, self.state
        result = self.evaluate(state, h, h)
        u = [a + h * b for a, b in zip(state.u, result.qdd, strict=True)]
        q = semi_implicit_positions(self.character.body.tree, state.q, u, h)
        self._advance_to(q, u, result.strains)
        return result

    def _runge_kutta(self) -> SubstepResult:
        h = self.step
        settled = self.evaluate(self.state, 0.0, 0.0)
        self._advance_to(self.state.q, self.state.u, settled.strains)
        self.state.memory.update({name: self._column(value) for name, value in settled.memory.items()})
        start = self.state
        total = [np.zeros(self.agent_count) for _ in _flat(start)]
        ahead = start
        for weight, reach in ((h / 6, h / 2), (h / 3, h / 2), (h / 3, h), (h / 6, 0.0)):
            result = self.evaluate(ahead, 0.0, 0.0)
            q_rate = position_rate(self.character.body.tree, ahead.q, ahead.u)
            rates = [*q_rate, *result.qdd, *(x for strain in result.strain_rates for x in strain)]
            total = [a + weight * b for a, b in zip(total, rates, strict=True)]
            ahead = _moved(start, [reach * rate for rate in rates])
        self.state = _moved(start, total)
        q = list(self.state.q)
        for node in self.character.body.tree.nodes:
            if node.kind in ("free", "ball"):
                first = node.q + (3 if node.kind == "free" else 0)
                q[first : first + 4] = quaternion_normalized(q[first : first + 4])
        self._advance_to(q, self.state.u, self.state.strains)
        return settled

    def _advance_to(self, q: Sequence, u: Sequence, strains: Sequence[Sequence]) -> None:
        self.state = AgentState(
            [self._column(x) for x in q],
            [self._column(x) for x in u],
            [[self._column(x) for x in strain] for strain in strains],
            self.state.memory,
            self.state.substep,
        )


def diverging_probe(expected: Sequence[Probe], found: Sequence[Probe], tolerance: float) -> Divergence | None:
    """The first probe whose values differ by more than `tolerance`, relative where they are larger than one."""
    for a, b in zip(expected, found, strict=True):
        if a.name != b.name:
            raise ValueError(f"probes come in different orders: {a.name!r} at {a.source}, {b.name!r} at {b.source}")
        wanted, had = np.asarray(a.value, dtype=float), np.asarray(b.value, dtype=float)
        off = np.abs(wanted - had) > tolerance * np.maximum(1.0, np.abs(wanted))
        if np.any(off | ~np.isfinite(had)):
            return Divergence(a.name, a.source, wanted, had)
    return None


def probes_of_substep(run: ReferenceRun) -> list[Probe]:
    """What the probes see in one evaluation of the present state."""
    with record_probes() as entries:
        run.evaluate(run.state, run.step, run.step)
    return entries


def _columns(array: np.ndarray) -> list[np.ndarray]:
    array = np.asarray(array, dtype=float)
    return [array[:, i].copy() for i in range(array.shape[1])]


def _flat(state: AgentState) -> list[np.ndarray]:
    return [*state.q, *state.u, *(x for strain in state.strains for x in strain)]


def _moved(state: AgentState, by: Sequence[np.ndarray]) -> AgentState:
    values = [a + b for a, b in zip(_flat(state), by, strict=True)]
    n, m = len(state.q), len(state.u)
    strains, rest = [], values[n + m :]
    for strain in state.strains:
        strains.append(rest[: len(strain)])
        rest = rest[len(strain) :]
    return AgentState(values[:n], values[n : n + m], strains, state.memory, state.substep)
