"""The engine: every agent through a whole frame in one launch.

Within a frame an agent is alone with the ground beneath it, so a thread (a *block* of as many agents as the target
has lanes) carries its agents from one frame boundary to the next (see `frame_kernel`) and nobody waits.

How agents are dealt out to lanes, blocks and threads cannot change a bit: no agent reads another's numbers, every
operation is elementwise across lanes, and padding lanes hold an agent that nobody reads.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from echelon.warp_kernels.character import Character
from echelon.warp_kernels.emit import Target, host_lanes
from echelon.warp_kernels.frame_kernel import compiled_program, frame_kernel, type_of
from echelon.warp_kernels.program import PLANE_SIZE, POSE_SIZE, Integrator
from echelon.warp_kernels.start import start_warp

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
        """Whether each site's plane must be looked up where it stands, every tick, rather than once a frame."""
        ...


@dataclass
class ChunkArrays:
    """What one chunk of frames leaves, on the device.

    Attributes:
        poses: Link poses relative to each agent's origin [m], shape [frames, agents, links, 7]
        origins: Floating origins in the world [m],              shape [frames, agents, 3], float64
        velocities: Of the first link, world axes [m/s],          shape [frames, agents, 3]
        desired: Commands that the frame was advanced with,       shape [frames, agents, commands]
        measures: What the character records,                     shape [frames, agents, records]
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
    measures: wp.array
    phases: wp.array
    contacts: wp.array
    fallen: wp.array
    frozen: wp.array
    events: wp.array

    @classmethod
    def allocate(cls, frames: int, agents: int, character: Character, device: wp.DeviceLike = None) -> ChunkArrays:
        """Arrays for a chunk of `frames` frames of a character."""
        links, commands, events = len(character.body.links), len(character.commands), len(character.events)

        def zeros(shape: tuple[int, ...], dtype: Any) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        return cls(
            poses=zeros((frames, agents, links, POSE_SIZE), wp.float32),
            origins=zeros((frames, agents, 3), wp.float64),
            velocities=zeros((frames, agents, 3), wp.float32),
            desired=zeros((frames, agents, max(commands, 1)), wp.float32),
            measures=zeros((frames, agents, max(len(character.records), 1)), wp.float32),
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
        self.program = compiled_program(
            character, self.step, tick * self.step, integrator, Target(lanes, cuda), terrain.level
        )
        self.layout = self.program.layout
        self.block_count = -(-agent_count // lanes)
        self._kernel = frame_kernel(self.program, terrain.look_up, type_of(terrain.data), terrain.rough)
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
        self._places = zeros(3 * len(self.program.located_sites))
        self._planes = zeros(PLANE_SIZE * len(body.contacts))
        self._seen = zeros(self.program.seen_size)
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
                    + [self._event_places, self.parameters, self.command],
                    outputs=[self.state, self.origins, self._command_lanes, self._backup]
                    + [self._places, self._planes, self._seen]
                    + [self.positions, self.velocities, self.fallen, chunk.poses, chunk.origins, chunk.velocities]
                    + [
                        chunk.desired,
                        chunk.measures,
                        chunk.phases,
                        chunk.contacts,
                        chunk.fallen,
                        chunk.frozen,
                        chunk.events,
                    ],
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
