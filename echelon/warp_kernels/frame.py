"""The fused frame kernel: every agent through a whole frame in one launch.

Within a frame an agent is alone with the ground beneath it, so a thread (a *block* of as many agents as the target
has lanes) carries its agents from one frame boundary to the next and nobody waits:

    rebase        the floating origin moves to where the root is, exactly, in float64
    look up       ground and walls beneath and beside each contact site become local planes
    tick x 8      control, then substeps with the state in registers
    check         an agent whose state is no longer finite goes back to where it was, and stays there
    observe       link poses, velocities, phase, flags and events, into the frame's slot of a chunk

How agents are dealt out to lanes, blocks and threads cannot change a bit: no agent reads another's numbers, every
operation is elementwise across lanes, and padding lanes hold an agent that nobody reads.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportInvalidTypeForm=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python. There is no
# `from __future__ import annotations`, since the kernel's types are variables of the function that makes it.

import itertools
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import warp as wp

from echelon.warp_kernels.character import Character
from echelon.warp_kernels.emit import Target, cpu_compiler_flags, host_lanes
from echelon.warp_kernels.program import PLANE_SIZE, POSE_SIZE, Integrator, Program
from echelon.warp_kernels.start import start_warp

SURFACES = {"ground": 0, "wall": 1}

THREAD_WORK = 4_000_000
"""Agents times substeps times operations that are worth waking a second thread for, per frame."""


class Terrain(Protocol):
    """What gives contact sites their local planes."""

    @property
    def data(self) -> Any:
        """A Warp struct instance that `look_up` reads."""
        ...

    @property
    def look_up(self) -> Any:
        """Warp function (surface, point in the world, data) -> plane (n, d) in the world, float64."""
        ...

    @property
    def level(self) -> bool:
        """Whether the ground's normal is +z everywhere."""
        ...

    @property
    def rough(self) -> bool:
        """Whether a plane must be looked up every tick rather than every frame."""
        ...


@dataclass
class ChunkArrays:
    """What one chunk of frames leaves, on the device.

    Attributes:
        poses: Link poses relative to each agent's origin [m], shape [frames, agents, links, 7]
        origins: Floating origins in the world [m],              shape [frames, agents, 3], float64
        velocities: Of the first link, world axes [m/s],          shape [frames, agents, 3]
        desired: Commands that the frame was advanced with,       shape [frames, agents, commands]
        phases: Controller phase,                                 shape [frames, agents], int8
        contacts: 1 where a foot is loaded,                       shape [frames, agents], uint8
        fallen: 1 where the agent has fallen,                     shape [frames, agents], uint8
        frozen: 1 where its state stopped being finite,           shape [frames, agents], uint8
        events: Substep of each of the character's events or -1,  shape [frames, agents, events], int16
    """

    poses: wp.array
    origins: wp.array
    velocities: wp.array
    desired: wp.array
    phases: wp.array
    contacts: wp.array
    fallen: wp.array
    frozen: wp.array
    events: wp.array

    @classmethod
    def allocate(cls, frames: int, agents: int, character: Character, device: wp.DeviceLike = None) -> "ChunkArrays":
        """Arrays for a chunk of `frames` frames of a character."""
        links, commands, events = len(character.body.links), len(character.commands), len(character.events)

        def zeros(shape: tuple[int, ...], dtype: Any) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        return cls(
            poses=zeros((frames, agents, links, POSE_SIZE), wp.float32),
            origins=zeros((frames, agents, 3), wp.float64),
            velocities=zeros((frames, agents, 3), wp.float32),
            desired=zeros((frames, agents, max(commands, 1)), wp.float32),
            phases=zeros((frames, agents), wp.int8),
            contacts=zeros((frames, agents), wp.uint8),
            fallen=zeros((frames, agents), wp.uint8),
            frozen=zeros((frames, agents), wp.uint8),
            events=zeros((frames, agents, max(events, 1)), wp.int16),
        )


class Engine:
    """All agents of one character: their state, and one launch a frame.

    Args:
        character: Who.
        agent_count: How many.
        terrain: Where.
        frame_rate: Frames a second.
        substeps: Substeps a frame.
        tick: Substeps a control tick; divides `substeps`.
        integrator: "semi-implicit" or "rk4".
        lanes: Agents a vector; 0 for what the machine has (1 on a GPU).
        threads: Threads on a CPU; 0 decides by the work there is.
        device: A Warp device.
    """

    def __init__(
        self,
        character: Character,
        agent_count: int,
        terrain: Terrain,
        *,
        frame_rate: int = 30,
        substeps: int = 24,
        tick: int = 6,
        integrator: Integrator = "semi-implicit",
        lanes: int = 0,
        threads: int = 0,
        device: str = "cpu",
    ) -> None:
        start_warp()
        cuda = device.startswith("cuda")
        lanes = 1 if cuda else lanes or host_lanes()
        if substeps % tick:
            raise ValueError(f"{substeps} substeps are not a whole number of ticks of {tick}")
        self.character = character
        self.terrain = terrain
        self.agent_count = agent_count
        self.frame_rate = frame_rate
        self.substeps = substeps
        self.tick = tick
        self.lanes = lanes
        self.device = device
        self.step = 1.0 / (frame_rate * substeps)
        self.program = _program(character, self.step, tick * self.step, integrator, Target(lanes, cuda), terrain.level)
        self.layout = self.program.layout
        self.block_count = -(-agent_count // lanes)
        self._kernel = _frame_kernel(self.program, terrain.look_up, type_of(terrain.data), terrain.rough)
        body = character.body

        def zeros(count: int, dtype: Any = wp.float32) -> wp.array:
            return wp.zeros((self.block_count, max(count, 1), lanes), dtype=dtype, device=device)

        self.state = zeros(self.layout.size)
        self.parameters = zeros(len(character.parameters))
        self.command = wp.zeros((agent_count, max(len(character.commands), 1)), dtype=wp.float32, device=device)
        self._command_lanes = zeros(len(character.commands))
        self.positions = wp.zeros(agent_count, dtype=wp.vec3, device=device)
        self.velocities = wp.zeros(agent_count, dtype=wp.vec3, device=device)
        self.fallen = wp.zeros(agent_count, dtype=wp.int32, device=device)
        self.origins = wp.zeros((self.block_count * lanes, 3), dtype=wp.float64, device=device)
        self._backup = zeros(self.layout.size)
        self._planes = zeros(PLANE_SIZE * len(body.contacts))
        self._seen = zeros(self.program.seen_size)
        self._surfaces = wp.array([SURFACES[site.surface] for site in body.contacts] or [0], dtype=int, device=device)
        self._event_places = wp.array(
            [self.layout.memory[name] for name in character.events] or [0], dtype=int, device=device
        )
        self._slices = self._divide(threads)
        self._pool = ThreadPoolExecutor(len(self._slices) - 1) if len(self._slices) > 1 else None
        self._graphs: list[Any] = []
        # Slot of the chunk and number of ticks of the next frame: read by the kernel, so that launches never change.
        self._clock = wp.zeros(2, dtype=wp.int32, device=device)
        self._clock_on_host = None if cuda else self._clock.numpy()
        self._chunk: ChunkArrays | None = None
        self.reset()

    # ---- state -----------------------------------------------------------------------------------------------------
    def reset(self) -> None:
        """Everybody in the reference pose at the world's origin, with the usual parameters and memory."""
        agents = self.block_count * self.lanes
        self.set_q(np.tile(self.character.body.q_reference, (agents, 1)))
        self.set_u(np.zeros((agents, self.character.body.u_count)))
        for name, value in self.character.memory.items():
            self.set_memory(name, np.full(agents, value))
        for name, value in self.character.parameters.items():
            self.set_parameter(name, np.full(agents, value))
        self.origins.zero_()

    def _spread(self, values: np.ndarray, count: int) -> np.ndarray:
        """[agents, count] to [blocks, count, lanes]; padding lanes repeat the last agent."""
        values = np.asarray(values, dtype=np.float32).reshape(-1, count)
        total = self.block_count * self.lanes
        if len(values) < total:
            values = np.concatenate([values, np.repeat(values[-1:], total - len(values), axis=0)])
        return values.reshape(self.block_count, self.lanes, count).transpose(0, 2, 1)

    def _assign(self, array: wp.array, first: int, values: np.ndarray, count: int) -> None:
        host = array.numpy()
        host[:, first : first + count, :] = self._spread(values, count)
        array.assign(host)

    def _gather(self, array: wp.array, first: int, count: int) -> np.ndarray:
        host = array.numpy()[:, first : first + count, :]
        return host.transpose(0, 2, 1).reshape(-1, count)[: self.agent_count].copy()

    def set_q(self, q: np.ndarray) -> None:
        """Generalised positions, shape [agents, q_count]; a free root's position is relative to its origin [m]."""
        self._assign(self.state, self.layout.q, q, self.character.body.q_count)

    def set_u(self, u: np.ndarray) -> None:
        """Generalised speeds, shape [agents, u_count]."""
        self._assign(self.state, self.layout.u, u, self.character.body.u_count)

    def set_memory(self, name: str, values: np.ndarray) -> None:
        """One variable of the controllers' memory, shape [agents]."""
        self._assign(self.state, self.layout.memory[name], values, 1)

    def set_parameter(self, name: str, values: np.ndarray) -> None:
        """One parameter of the individuals, shape [agents]."""
        self._assign(self.parameters, self.program.parameter_names.index(name), values, 1)

    def set_command(self, name: str, values: np.ndarray) -> None:
        """One command, shape [agents]."""
        host = self.command.numpy()
        host[:, self.character.commands.index(name)] = values
        self.command.assign(host)

    def set_origins(self, origins: np.ndarray) -> None:
        """Floating origins in the world [m], float64, shape [agents, 3]."""
        host = self.origins.numpy()
        origins = np.asarray(origins, dtype=np.float64)
        host[: len(origins)] = origins
        host[len(origins) :] = origins[-1]
        self.origins.assign(host)

    @property
    def q(self) -> np.ndarray:
        """Generalised positions, shape [agents, q_count], float32."""
        return self._gather(self.state, self.layout.q, self.character.body.q_count)

    @property
    def u(self) -> np.ndarray:
        """Generalised speeds, shape [agents, u_count], float32."""
        return self._gather(self.state, self.layout.u, self.character.body.u_count)

    def memory(self, name: str) -> np.ndarray:
        """One variable of the controllers' memory, shape [agents], float32."""
        return self._gather(self.state, self.layout.memory[name], 1)[:, 0]

    @property
    def frozen(self) -> np.ndarray:
        """Which agents' state stopped being finite, shape [agents], bool."""
        return self._gather(self.state, self.layout.frozen, 1)[:, 0] > 0.5

    def full_state(self) -> dict[str, np.ndarray]:
        """Everything that the next frame depends on, by agent: for checkpoints, and for comparing runs."""
        return {
            "state": self._gather(self.state, 0, self.layout.size),
            "parameters": self._gather(self.parameters, 0, max(len(self.program.parameter_names), 1)),
            "origins": self.origins.numpy()[: self.agent_count].copy(),
            "positions": self.positions.numpy().copy(),
            "velocities": self.velocities.numpy().copy(),
            "down": self.fallen.numpy().copy(),
            "command": self.command.numpy().copy(),
        }

    def load_full_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Back to what `full_state` gave."""
        self._assign(self.state, 0, arrays["state"], self.layout.size)
        self._assign(self.parameters, 0, arrays["parameters"], max(len(self.program.parameter_names), 1))
        self.set_origins(arrays["origins"])
        self.positions.assign(arrays["positions"])
        self.velocities.assign(arrays["velocities"])
        self.fallen.assign(arrays["down"])
        self.command.assign(arrays["command"])

    # ---- frames ----------------------------------------------------------------------------------------------------
    def _divide(self, threads: int) -> list[tuple[int, int]]:
        """(first block, count) for each thread."""
        if self.device != "cpu":
            return [(0, self.block_count)]
        if threads <= 0:
            work = self.agent_count * self.substeps * self.program.substep_operations
            threads = min(os.cpu_count() or 1, max(1, work // THREAD_WORK))
        threads = max(1, min(threads, self.block_count))
        bounds = [self.block_count * i // threads for i in range(threads + 1)]
        return [(a, b - a) for a, b in itertools.pairwise(bounds)]

    def bind(self, chunk: ChunkArrays) -> None:
        """Choose the chunk that frames are observed into, and capture the launches, so that repeating them is cheap."""
        self._chunk = chunk
        wp.load_module(self._kernel.module, device=self.device)
        self._graphs = []
        for first, count in self._slices:
            with wp.ScopedCapture(device=self.device) as capture:
                wp.launch(
                    self._kernel,
                    dim=count,
                    inputs=[first, self.agent_count, self.tick, self._clock, self.terrain.data]
                    + [self._surfaces, self._event_places, self.parameters, self.command],
                    outputs=[self.state, self.origins, self._command_lanes, self._backup, self._planes, self._seen]
                    + [self.positions, self.velocities, self.fallen, chunk.poses, chunk.origins, chunk.velocities]
                    + [chunk.desired, chunk.phases, chunk.contacts, chunk.fallen, chunk.frozen, chunk.events],
                    device=self.device,
                    block_dim=64,
                )
            self._graphs.append(capture.graph)

    def advance(self, slot: int, *, observe_only: bool = False) -> None:
        """Carry everybody through one frame and leave what is seen in a slot of the bound chunk.

        Args:
            slot: Frame within the chunk.
            observe_only: Do not move; only observe (the first frame of a run).
        """
        ticks = 0 if observe_only else self.substeps // self.tick
        if self._clock_on_host is not None:
            self._clock_on_host[:] = (slot, ticks)
        else:
            self._clock.assign(np.array([slot, ticks], dtype=np.int32))
        if self._pool is None:
            for graph in self._graphs:
                wp.capture_launch(graph)
            return
        waiting = [self._pool.submit(wp.capture_launch, graph) for graph in self._graphs[1:]]
        wp.capture_launch(self._graphs[0])
        for future in waiting:
            future.result()

    def close(self) -> None:
        """Let the threads go."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


def type_of(data: Any) -> Any:
    """The Warp type to annotate a kernel argument with that takes this struct instance."""
    return data._cls


@lru_cache(maxsize=32)
def _program(
    character: Character, step: float, tick: float, integrator: Integrator, target: Target, level: bool
) -> Program:
    return Program(character, step, tick, integrator, target, level)


@lru_cache(maxsize=64)
def _frame_kernel(program: Program, look_up: Any, terrain_type: Any, rough: bool) -> Any:
    """The frame kernel of one program on one kind of terrain."""
    lanes = program.target.lanes
    layout = program.layout
    body = program.character.body
    control, substeps, observe = program.control, program.substeps, program.observe
    begin, keep_finite, keep_poses = program.begin, program.keep_finite, program.keep_poses
    site_count = len(body.contacts)
    link_count = len(body.links)
    event_count = len(program.character.events)
    command_count = len(program.character.commands)
    free_root = body.links[0].joint.kind == "free"
    # The origin stays where it is for a body that is tied to the world, and takes other free roots along.
    floats = free_root and all(None not in (spring.link_a, spring.link_b) for spring in body.springs)
    later_roots = [layout.q + body.q_start(i) for i in range(1, link_count) if body.links[i].joint.kind == "free"]
    later_root_count = len(later_roots)
    later_root_places = wp.types.vector(length=max(later_root_count, 1), dtype=wp.int32)(*(later_roots or [0]))
    phase_at, fallen_at, loaded_at = (layout.memory[name] for name in ("phase", "fallen", "loaded"))
    frozen_at = layout.frozen
    root_q = layout.q
    velocity_at = POSE_SIZE * link_count

    @wp.func
    def look_up_planes(
        block: int,
        lane: int,
        terrain: terrain_type,
        surfaces: wp.array[int],
        state: wp.array3d[wp.float32],
        origins: wp.array2d[wp.float64],
        planes_out: wp.array3d[wp.float32],
    ):
        """Planes of all sites of one agent, looked up where its root is, relative to its origin."""
        agent = block * lanes + lane
        origin = wp.vec3d(origins[agent, 0], origins[agent, 1], origins[agent, 2])
        point = origin
        if wp.static(free_root):
            point = origin + wp.vec3d(
                wp.float64(state[block, root_q, lane]),
                wp.float64(state[block, root_q + 1, lane]),
                wp.float64(state[block, root_q + 2, lane]),
            )
        for site in range(site_count):
            plane = look_up(surfaces[site], point, terrain)
            offset = plane[3] - plane[0] * origin[0] - plane[1] * origin[1] - plane[2] * origin[2]
            planes_out[block, 4 * site, lane] = wp.float32(plane[0])
            planes_out[block, 4 * site + 1, lane] = wp.float32(plane[1])
            planes_out[block, 4 * site + 2, lane] = wp.float32(plane[2])
            planes_out[block, 4 * site + 3, lane] = wp.float32(offset)

    @wp.kernel(module="unique", module_options=_module_options(program), enable_backward=False)
    def advance_frame(
        first_block: int,
        agent_count: int,
        tick: int,
        clock: wp.array[int],
        # where
        terrain: terrain_type,
        surfaces: wp.array[int],
        event_places: wp.array[int],
        # who
        parameters: wp.array3d[wp.float32],
        command: wp.array2d[wp.float32],
        # state
        state: wp.array3d[wp.float32],
        origins: wp.array2d[wp.float64],
        command_lanes: wp.array3d[wp.float32],
        backup: wp.array3d[wp.float32],
        planes: wp.array3d[wp.float32],
        seen: wp.array3d[wp.float32],
        # out: what the group sees
        positions_out: wp.array[wp.vec3],
        velocities_out: wp.array[wp.vec3],
        fallen_out: wp.array[wp.int32],
        # out: the recording
        poses_out: wp.array4d[wp.float32],
        origins_out: wp.array3d[wp.float64],
        chunk_velocities_out: wp.array3d[wp.float32],
        chunk_desired_out: wp.array3d[wp.float32],
        phases_out: wp.array2d[wp.int8],
        contacts_out: wp.array2d[wp.uint8],
        chunk_fallen_out: wp.array2d[wp.uint8],
        frozen_out: wp.array2d[wp.uint8],
        events_out: wp.array3d[wp.int16],
    ):
        block = first_block + wp.tid()
        slot = clock[0]
        tick_count = clock[1]
        for lane in range(lanes):
            agent = block * lanes + lane
            if wp.static(floats):
                for axis in range(3):
                    shift = state[block, root_q + axis, lane]
                    # What is not finite stays in the state, where it will be noticed.
                    if wp.isfinite(shift):
                        origins[agent, axis] = origins[agent, axis] + wp.float64(shift)
                        state[block, root_q + axis, lane] = wp.float32(0.0)
                        for root in range(later_root_count):
                            place = later_root_places[root] + axis
                            state[block, place, lane] = state[block, place, lane] - shift
            for part in range(command_count):
                command_lanes[block, part, lane] = command[wp.min(agent, agent_count - 1), part]
        begin(state, backup, block)
        for lane in range(lanes):
            look_up_planes(block, lane, terrain, surfaces, state, origins, planes)

        for count in range(tick_count):
            if wp.static(rough) and count > 0:
                for lane in range(lanes):
                    look_up_planes(block, lane, terrain, surfaces, state, origins, planes)
            control(state, parameters, command_lanes, block)
            substeps(state, parameters, command_lanes, planes, block, tick)

        # Whatever is not finite, or was frozen before, stays where it was at the start of the frame.
        keep_finite(state, backup, block)
        observe(state, seen, block)
        keep_poses(seen, poses_out, block, slot, agent_count)
        for lane in range(lanes):
            agent = block * lanes + lane
            if agent < agent_count:
                for axis in range(3):
                    origins_out[slot, agent, axis] = origins[agent, axis]
                    chunk_velocities_out[slot, agent, axis] = seen[block, velocity_at + axis, lane]
                phases_out[slot, agent] = wp.int8(state[block, phase_at, lane])
                for part in range(command_count):
                    chunk_desired_out[slot, agent, part] = command_lanes[block, part, lane]
                contacts_out[slot, agent] = wp.uint8(wp.where(state[block, loaded_at, lane] > 0.5, 1, 0))
                lost = wp.where(state[block, frozen_at, lane] > 0.5, 1, 0)
                down = wp.where(state[block, fallen_at, lane] > 0.5, 1, 0)
                chunk_fallen_out[slot, agent] = wp.uint8(down)
                frozen_out[slot, agent] = wp.uint8(lost)
                fallen_out[agent] = wp.max(down, lost)
                for event in range(event_count):
                    events_out[slot, agent, event] = wp.int16(state[block, event_places[event], lane])
                positions_out[agent] = wp.vec3(
                    wp.float32(origins[agent, 0] + wp.float64(seen[block, 0, lane])),
                    wp.float32(origins[agent, 1] + wp.float64(seen[block, 1, lane])),
                    wp.float32(origins[agent, 2] + wp.float64(seen[block, 2, lane])),
                )
                velocities_out[agent] = wp.vec3(
                    seen[block, velocity_at, lane],
                    seen[block, velocity_at + 1, lane],
                    seen[block, velocity_at + 2, lane],
                )

    return advance_frame


def _module_options(program: Program) -> dict[str, Any]:
    # Unrolling the loops over lanes would only make more to compile. Multiply-adds stand in the code (see `emit`),
    # and the compilers, CUDA's too, are to make no others.
    options: dict[str, Any] = {"enable_backward": False, "max_unroll": 1, "fuse_fp": False}
    if not program.target.cuda:
        options["cpu_compiler_flags"] = cpu_compiler_flags(program.target.lanes)
    return options
