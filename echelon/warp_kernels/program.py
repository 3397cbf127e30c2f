"""A character as native code: its controller, its substep and what is seen of it, each one emitted function.

`Program` traces a `Character` once for a given step and target and holds the three native Warp functions that
`frame` calls:

* ``control(state, parameters, command, block)``: one control tick;
* ``substeps(state, parameters, command, planes, ghosts, law, block, meeting, count)``: ``count`` substeps, the state
  held in registers, beside the first ``meeting`` ghosts of each agent (see `meeting`);
* ``begin(state, backup, block)``: at the start of a frame, wrap angles, clear latches and keep a copy;
* ``keep_finite(state, backup, block)``: at its end, put agents whose state is not finite back to the copy;
* ``locate(state, places, block)``: where the sites are whose ground must be looked up where they stand;
* ``observe(state, seen, block)``: link poses and velocities at the end of a frame;
* ``keep_poses(seen, poses, block, slot, agent_count)``: the poses into the frame's slot of a chunk, agent by agent.

All arrays are ``[block, variable, lane]`` of float32.

One substep under semi-implicit Euler is: kinematics; contacts; control's torques; articulated-body dynamics with every
stiff term taken implicitly; speeds; then positions with the new speeds. Strains grow at the beginning of a substep
with the speeds that the last one ended with, which is the same update. Runge-Kutta first settles contacts (drags and
releases anchors) and latches, then calls one right-hand side four times.

Who meets others is pushed by them once a substep: the sum of what ghosts do is a wrench on the first link that the
substep always adds, zero where no ghost is near, so that skipping them changes no bit. Runge-Kutta holds it for a step.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import warp as wp

from echelon.warp_kernels import articulated
from echelon.warp_kernels.character import LOST, NO_EVENT, AgentState, Character, StateLayout, View
from echelon.warp_kernels.contact import Contact, JointForces, contact, spring_forces, strain_count
from echelon.warp_kernels.emit import Target, operation_count, statements
from echelon.warp_kernels.integrate import position_rate, semi_implicit_positions, wrapped_positions
from echelon.warp_kernels.kinematics import kinematics, link_poses
from echelon.warp_kernels.meeting import Bumper
from echelon.warp_kernels.meeting_code import MeetingCode, meeting_code
from echelon.warp_kernels.spatial import (
    add,
    apply,
    apply_transposed,
    cross,
    quaternion_normalized,
    scale,
)
from echelon.warp_kernels.stability import check_explicit_forces
from echelon.warp_kernels.trace import Expr, Graph

Integrator = Literal["semi-implicit", "rk4"]
PLANE_SIZE = 4  # n_x, n_y, n_z, d of the local plane of one contact site
POSE_SIZE = 7
FASTEST, LARGEST_FLOAT = 3.4e4, 3.4e38
"""An agent any of whose speeds is greater [m/s, rad/s] counts as one whose state is not finite."""
SEEN_EXTRA = 6  # after the poses: velocity of the first link's origin and its angular velocity, world axes


@dataclass(frozen=True)
class SubstepResult:
    """What one substep's evaluation gives."""

    qdd: list[Any]
    strains: list[list[Any]]
    strain_rates: list[list[Any]]
    memory: dict[str, Any]


def evaluate_substep(
    character: Character,
    state: AgentState,
    parameters: dict[str, Any],
    command: dict[str, Any],
    planes: Sequence[Sequence[Any]],
    step: float,
    tick: float,
    implicit_step: float,
    advance: float,
    wrench: Sequence[Any] | None = None,
) -> SubstepResult:
    """Contacts, torques and accelerations of one agent: the physics of a substep, over any scalars.

    Args:
        step, tick: Length of a substep and of a control tick [s].
        implicit_step: Length of a substep where stiff forces are taken implicitly, 0 where they are plain.
        advance: By how much strains have grown since they were stored [s].
        wrench: What others push the first link with: moment about its origin [N m] and force [N], in its axes.
    """
    body = character.body
    kin = kinematics(body.tree, state.q, state.u)
    contacts: dict[str, Contact] = {}
    loads: dict[int, list[Any]] = {}
    for site, plane, strain in zip(body.contacts, planes, state.strains, strict=True):
        found = contact(kin, body, site, plane, strain, implicit_step, advance)
        contacts[site.name] = found
        loads.setdefault(body.link_index(site.link), []).append(found.load)
    joints = JointForces.none(body.u_count)
    joints.limits(body, state.q, state.u, implicit_step)
    view = View(
        state.q,
        state.u,
        kin,
        dict(state.memory),
        parameters,
        command,
        state.substep,
        step,
        tick,
        implicit_step,
        contacts,
    )
    character.actuate(view, joints)
    forces = spring_forces(kin, body, view.springs)
    for name, push in view.pushes.items():
        index = body.link_index(name)
        force = apply_transposed(kin.world(body.tree.node_of_link[index])[0], list(push))
        moment = cross(list(body.links[index].com), force)
        forces.setdefault(index, []).append((moment, force))
    if wrench is not None:
        forces.setdefault(0, []).append((list(wrench[:3]), list(wrench[3:])))
    qdd = articulated.forward_dynamics(kin, joints.tau, joints.implicit, loads, forces)
    found_in_order = [contacts[site.name] for site in body.contacts]
    return SubstepResult(qdd, [c.strain for c in found_in_order], [c.strain_rate for c in found_in_order], view.memory)


class Program:
    """A character compiled for one step length, integrator and target.

    Attributes:
        character: What was compiled.
        layout: Where each state variable stands.
        target: Lanes and kind of processor.
        level_ground: Whether the ground's normal is +z everywhere, which saves arithmetic.
        substep_operations: Arithmetic operations of one substep, for reports.
        located_sites: Places in the model's list of the sites that `locate` finds: those that usually touch the ground.
        bumper: What others meet of it; None where it meets nobody.
        key: A name that changes exactly when the code does.
    """

    def __init__(
        self,
        character: Character,
        step: float,
        tick: float,
        integrator: Integrator,
        target: Target,
        level_ground: bool = False,
        bumper: Bumper | None = None,
    ) -> None:
        if integrator == "semi-implicit":
            check_explicit_forces(character.body, step)
        self.character = character
        self.step = step
        self.tick = tick
        self.integrator = integrator
        self.target = target
        self.level_ground = level_ground
        self.bumper = bumper
        self.layout = StateLayout.of(character.body, character.memory, self.bumper is not None)
        self.parameter_names = tuple(character.parameters)
        self.seen_size = POSE_SIZE * len(character.body.links) + SEEN_EXTRA
        self.substep_operations = 0
        sites = character.body.contacts
        self.located_sites = tuple(i for i, s in enumerate(sites) if s.surface == "ground" and s.use == "usual")
        sources = {
            "control": self._control_source(),
            "substeps": self._substeps_source(),
            "locate": self._locate_source(),
            "observe": self._observe_source(),
            "begin": self._begin_source(),
            "keep_finite": self._keep_finite_source(),
            "keep_poses": self._keep_poses_source(),
        }
        self.sources = sources
        self.key = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:12]
        self.control = self._native(sources["control"], _control_stub)
        self.substeps = self._native(sources["substeps"], _substeps_stub)
        self.locate = self._native(sources["locate"], _locate_stub)
        self.observe = self._native(sources["observe"], _observe_stub)
        self.begin = self._native(sources["begin"], _backup_stub)
        self.keep_finite = self._native(sources["keep_finite"], _backup_stub)
        self.keep_poses = self._native(sources["keep_poses"], _poses_stub)

    @staticmethod
    def _native(source: str, stub: Any) -> Any:
        return wp.func_native(source)(stub)

    # ---- inputs ----------------------------------------------------------------------------------------------------
    def _variables(self, graph: Graph, array: str = "s") -> AgentState:
        layout, body = self.layout, self.character.body
        return AgentState(
            q=[graph.input(f"{array}[{layout.q + i}]") for i in range(body.q_count)],
            u=[graph.input(f"{array}[{layout.u + i}]") for i in range(body.u_count)],
            strains=[
                [graph.input(f"{array}[{start + i}]") for i in range(strain_count(site))]
                for site, start in zip(body.contacts, layout.strain, strict=True)
            ],
            memory={name: graph.input(f"s[{at}]") for name, at in layout.memory.items()},
            substep=graph.input(f"s[{layout.substep}]"),
        )

    def _parameters(self, graph: Graph) -> dict[str, Any]:
        return {name: graph.input(f"p[{i}]") for i, name in enumerate(self.parameter_names)}

    def _command(self, graph: Graph) -> dict[str, Any]:
        return {name: graph.input(f"c[{i}]") for i, name in enumerate(self.character.commands)}

    def _planes(self, graph: Graph) -> list[list[Any]]:
        """Plane of each site; what is known of it beforehand is a constant, and folds."""
        planes: list[list[Any]] = []
        for place, site in enumerate(self.character.body.contacts):
            plane: list[Any] = [graph.input(f"g[{PLANE_SIZE * place + i}]") for i in range(PLANE_SIZE)]
            if site.surface == "wall":
                plane[2] = 0.0
            elif self.level_ground:
                plane[:3] = [0.0, 0.0, 1.0]
            planes.append(plane)
        return planes

    # ---- sources ---------------------------------------------------------------------------------------------------
    def _pointer(self, name: str, array: str, size: int) -> str:
        return f"lanes_in_memory* {name} = (lanes_in_memory*)({array}.data) + (size_t)block * {max(size, 1)};\n"

    def _load_inputs(self, with_planes: bool) -> str:
        """Copies of what does not change during the call: a reference to memory would be read again and again."""
        code = self._pointer("P", "parameters", len(self.parameter_names))
        code += self._pointer("C", "command", len(self.character.commands))
        sizes = [("p", "P", len(self.parameter_names)), ("c", "C", len(self.character.commands))]
        if with_planes:
            plane_count = PLANE_SIZE * len(self.character.body.contacts)
            code += self._pointer("G", "planes", plane_count)
            sizes.append(("g", "G", plane_count))
        for local, pointer, size in sizes:
            code += f"lanes {local}[{max(size, 1)}];\nfor (int i = 0; i < {size}; ++i) {local}[i] = {pointer}[i];\n"
        return code

    def _control_source(self) -> str:
        graph = Graph()
        state = self._variables(graph)
        kin = kinematics(self.character.body.tree, state.q, state.u)
        view = View(
            state.q,
            state.u,
            kin,
            dict(state.memory),
            self._parameters(graph),
            self._command(graph),
            state.substep,
            self.step,
            self.tick,
            self.step,
        )
        self.character.control(view)
        outputs = self._changed_memory(graph, state, view.memory)
        code = self.target.preamble + self._pointer("s", "state", self.layout.size) + self._load_inputs(False)
        return code + statements(graph, outputs, self.target)

    def _changed_memory(self, graph: Graph, before: AgentState, after: dict[str, Any]) -> list[tuple[str, Expr]]:
        unknown = sorted(set(after) - set(before.memory))
        if unknown:
            raise ValueError(f"character {self.character.name!r}: memory {unknown[0]!r} was never declared")
        return [
            (f"s[{self.layout.memory[name]}]", graph.lift(value))
            for name, value in after.items()
            if not (isinstance(value, Expr) and value.index == before.memory[name].index)
        ]

    def _substeps_source(self) -> str:
        size = self.layout.size
        code = self.target.preamble + self._pointer("S", "state", size) + self._load_inputs(True)
        code += f"lanes s[{size}];\nfor (int i = 0; i < {size}; ++i) s[i] = S[i];\n"
        met = self._meeting_code()
        code += met.before + "for (int k = 0; k < count; ++k) {\n" + met.each_substep
        code += self._semi_implicit() if self.integrator == "semi-implicit" else self._runge_kutta()
        code += "}\n"
        return code + f"for (int i = 0; i < {size}; ++i) S[i] = s[i];\n"

    def _meeting_code(self) -> MeetingCode:
        if self.bumper is None:
            return MeetingCode("", "")
        graph, touch = Graph(), self.layout.touch
        return meeting_code(graph, self._variables(graph), self.bumper, self.step, f"s[{touch}]", self.target)

    def _traced(self, graph: Graph, state: AgentState, implicit_step: float) -> SubstepResult:
        """One substep's physics as expressions; with `implicit_step` zero forces are plain and strains stand still."""
        return evaluate_substep(
            self.character,
            state,
            self._parameters(graph),
            self._command(graph),
            self._planes(graph),
            self.step,
            self.tick,
            implicit_step,
            implicit_step,
            None if self.bumper is None else [graph.input(f"w[{i}]") for i in range(6)],
        )

    def _semi_implicit(self) -> str:
        graph, h = Graph(), self.step
        state = self._variables(graph)
        result = self._traced(graph, state, h)
        tree, layout = self.character.body.tree, self.layout
        u = [a + h * b for a, b in zip(state.u, result.qdd, strict=True)]
        q = semi_implicit_positions(tree, state.q, u, h)
        outputs = [(f"s[{layout.q + i}]", graph.lift(value)) for i, value in enumerate(q)]
        outputs += [(f"s[{layout.u + i}]", graph.lift(value)) for i, value in enumerate(u)]
        outputs += self._strain_outputs(graph, result.strains, "s")
        outputs += self._changed_memory(graph, state, result.memory)
        outputs.append((f"s[{layout.substep}]", graph.lift(state.substep + 1.0)))
        self.substep_operations = operation_count(graph, [value for _, value in outputs])
        return statements(graph, outputs, self.target)

    def _runge_kutta(self) -> str:
        h, layout, body = self.step, self.layout, self.character.body
        # Settle: anchors dragged and released, latches and memory, all at the start of the step.
        graph = Graph()
        state = self._variables(graph)
        settled = self._traced(graph, state, 0.0)
        outputs = self._strain_outputs(graph, settled.strains, "s")
        outputs += self._changed_memory(graph, state, settled.memory)
        self.substep_operations = operation_count(graph, [value for _, value in outputs])
        code = "{\n" + statements(graph, outputs, self.target, "a") + "}\n"
        # Right-hand side: rates d[] of y[], the leading part of the state (q, u, strains).
        count = layout.u + body.u_count + sum(strain_count(site) for site in body.contacts)
        graph = Graph()
        state = self._variables(graph, "y")
        rates = self._traced(graph, state, 0.0)
        q_rate = position_rate(body.tree, state.q, state.u)
        outputs = [(f"d[{layout.q + i}]", graph.lift(value)) for i, value in enumerate(q_rate)]
        outputs += [(f"d[{layout.u + i}]", graph.lift(value)) for i, value in enumerate(rates.qdd)]
        outputs += self._strain_outputs(graph, rates.strain_rates, "d")
        self.substep_operations += 4 * operation_count(graph, [value for _, value in outputs])
        fma = self.target.function("fma")
        code += f"lanes y[{count}], total[{count}];\n"
        code += f"for (int i = 0; i < {count}; ++i) {{ y[i] = s[i]; total[i] = s[i]; }}\n"
        code += "for (int stage = 0; stage < 4; ++stage) {\n"
        code += f"lanes d[{count}];\n" + statements(graph, outputs, self.target, "b")
        code += f"const lanes weight = (lanes)((stage == 0 || stage == 3) ? {(h / 6):.9g}f : {(h / 3):.9g}f);\n"
        code += f"const lanes ahead = (lanes)(stage == 2 ? {h:.9g}f : {(h / 2):.9g}f);\n"
        code += f"for (int i = 0; i < {count}; ++i) {{ total[i] = {fma}(weight, d[i], total[i]); "
        code += f"y[i] = {fma}(ahead, d[i], s[i]); }}\n}}\n"
        code += f"for (int i = 0; i < {count}; ++i) s[i] = total[i];\n"
        # Quaternions back to unit length.
        graph = Graph()
        state = self._variables(graph)
        outputs = []
        for node in body.tree.nodes:
            if node.kind in ("free", "ball"):
                start = node.q + (3 if node.kind == "free" else 0)
                unit = quaternion_normalized(state.q[start : start + 4])
                outputs += [(f"s[{start + i}]", graph.lift(value)) for i, value in enumerate(unit)]
        outputs.append((f"s[{layout.substep}]", graph.lift(state.substep + 1.0)))
        return code + "{\n" + statements(graph, outputs, self.target, "c") + "}\n"

    def _strain_outputs(self, graph: Graph, strains: Sequence[Sequence[Any]], array: str) -> list[tuple[str, Expr]]:
        return [
            (f"{array}[{start + i}]", graph.lift(value))
            for start, values in zip(self.layout.strain, strains, strict=True)
            for i, value in enumerate(values)
        ]

    def _locate_source(self) -> str:
        """Where the located sites will be half a tick from now: the middle of the time that a plane is used for."""
        graph = Graph()
        state = self._variables(graph)
        body = self.character.body
        kin = kinematics(body.tree, state.q, state.u)
        outputs: list[tuple[str, Expr]] = []
        for index in self.located_sites:
            site = body.contacts[index]
            node = body.tree.node_of_link[body.link_index(site.link)]
            rotation, origin = kin.world(node)
            velocity = add(kin.world_velocity(node), apply(rotation, cross(kin.omega[node], list(site.position))))
            place = add(add(origin, apply(rotation, list(site.position))), scale(0.5 * self.tick, velocity))
            outputs += [(f"L[{len(outputs) + axis}]", graph.lift(x)) for axis, x in enumerate(place)]
        code = self.target.preamble + self._pointer("s", "state", self.layout.size)
        code += self._pointer("L", "places", 3 * len(self.located_sites))
        return code + statements(graph, outputs, self.target)

    def _observe_source(self) -> str:
        graph = Graph()
        state = self._variables(graph)
        body = self.character.body
        kin = kinematics(body.tree, state.q, state.u)
        values: list[Any] = []
        for pose in link_poses(kin):
            values += pose
        rotation, _ = kin.world(body.tree.node_of_link[0])
        values += kin.world_velocity(body.tree.node_of_link[0])
        values += apply(rotation, kin.omega[body.tree.node_of_link[0]])
        outputs = [(f"O[{i}]", graph.lift(value)) for i, value in enumerate(values)]
        code = self.target.preamble + self._pointer("s", "state", self.layout.size)
        code += self._pointer("O", "seen", self.seen_size)
        return code + statements(graph, outputs, self.target)

    def _begin_source(self) -> str:
        size = self.layout.size
        code = self.target.preamble + self._pointer("s", "state", size) + self._pointer("b", "backup", size)
        graph = Graph()
        state = self._variables(graph)
        wrapped = wrapped_positions(self.character.body.tree, state.q)
        outputs = [(f"s[{self.layout.q + at}]", graph.lift(value)) for at, value in wrapped.items()]
        code += statements(graph, outputs, self.target)
        for name in self.character.events:
            code += f"s[{self.layout.memory[name]}] = (lanes)({NO_EVENT}f);\n"
        if self.layout.touch is not None:
            touch = self.layout.touch
            code += f"s[{touch + 1}] = s[{touch}];\ns[{touch}] = (lanes)({NO_EVENT}f);\n"
        code += f"s[{self.layout.substep}] = (lanes)(0.0f);\n"
        return code + f"for (int i = 0; i < {size}; ++i) b[i] = s[i];\n"

    def _keep_finite_source(self) -> str:
        size, frozen = self.layout.size, self.layout.frozen
        code = self.target.preamble + self._pointer("s", "state", size) + self._pointer("b", "backup", size)
        # Zero times a finite number is zero; times an infinity or a NaN it is not.
        code += "lanes total = (lanes)(0.0f);\n"
        code += f"for (int i = 0; i < {size}; ++i) total += s[i] * (lanes)(0.0f);\n"
        # A speed that no character has is on its way there, and would take others along: it overflows.
        first, last = self.layout.u, self.layout.u + self.character.body.u_count
        code += f"for (int i = {first}; i < {last}; ++i) "
        code += f"total += (s[i] * (lanes)({LARGEST_FLOAT / FASTEST:.1e}f)) * (lanes)(0.0f);\n"
        code += f"const mask lost = ((total == (lanes)(0.0f)) == 0) | (b[{frozen}] > (lanes)(0.5f));\n"
        code += f"if ({self.target.any_lane('lost')}) {{\n"
        code += f"for (int i = 0; i < {size}; ++i) {{ const lanes now = s[i], then = b[i]; "
        code += "s[i] = (lost ? then : now); }\n"
        code += f"const lanes flag = s[{frozen}];\nconst mask known = flag > (lanes)({LOST}f);\n"
        code += f"const lanes why = (known ? flag : (lanes)({LOST}f));\ns[{frozen}] = (lost ? why : flag);\n}}\n"
        return code

    def _keep_poses_source(self) -> str:
        count, lanes = POSE_SIZE * len(self.character.body.links), self.target.lanes
        return (
            f"for (int lane = 0; lane < {lanes}; ++lane) {{\n"
            f"const int agent = block * {lanes} + lane;\n"
            "if (agent >= agent_count) break;\n"
            f"const float* from = (const float*)(seen.data) + (size_t)block * {self.seen_size * lanes} + lane;\n"
            f"float* to = (float*)(poses.data) + ((size_t)slot * agent_count + agent) * {count};\n"
            f"for (int i = 0; i < {count}; ++i) to[i] = from[i * {lanes}];\n}}\n"
        )


# Typed stubs of the native functions; their arguments are the names that the emitted code uses.
def _control_stub(
    state: wp.array3d[wp.float32], parameters: wp.array3d[wp.float32], command: wp.array3d[wp.float32], block: int
): ...


def _substeps_stub(
    state: wp.array3d[wp.float32],
    parameters: wp.array3d[wp.float32],
    command: wp.array3d[wp.float32],
    planes: wp.array3d[wp.float32],
    ghosts: wp.array3d[wp.float32],
    law: wp.array[wp.float32],
    block: int,
    meeting: int,
    count: int,
): ...


def _poses_stub(
    seen: wp.array3d[wp.float32], poses: wp.array4d[wp.float32], block: int, slot: int, agent_count: int
): ...


def _backup_stub(state: wp.array3d[wp.float32], backup: wp.array3d[wp.float32], block: int): ...


def _locate_stub(state: wp.array3d[wp.float32], places: wp.array3d[wp.float32], block: int): ...


def _observe_stub(state: wp.array3d[wp.float32], seen: wp.array3d[wp.float32], block: int): ...
