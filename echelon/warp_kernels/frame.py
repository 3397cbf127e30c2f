"""The engine: every agent through a whole frame in one launch.

Within a frame an agent is alone with the ground beneath it, so a thread (a *block* of as many agents as the target
has lanes) carries its agents from one frame boundary to the next (see `frame_kernel`) and nobody waits.

How agents are dealt out to lanes, blocks and threads cannot change a bit: no agent reads another's numbers, every
operation is elementwise across lanes, and padding lanes hold an agent that nobody reads.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
import warp as wp

from echelon.warp_kernels.bumper import bumper_of
from echelon.warp_kernels.character import LOST, Character
from echelon.warp_kernels.emit import Target, host_lanes
from echelon.warp_kernels.frame_kernel import compiled_program, frame_kernel, type_of
from echelon.warp_kernels.meetings import ContactSettings, Meetings, NobodyMet
from echelon.warp_kernels.program import PLANE_SIZE, POSE_SIZE, Integrator
from echelon.warp_kernels.replay import Graphs, Phase, Team, dealt
from echelon.warp_kernels.scripts import NOT_BEGUN
from echelon.warp_kernels.start import start_warp

THREAD_WORK = 16_000_000
"""Agents times substeps times operations that are worth a thread, per frame: waking threads takes a third of a
millisecond altogether."""


LARGEST_ROW = 2**24
"""Rows are counted in float32, exactly up to here."""


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
        touches: Substep in which another was touched, who was
            not in the frame before, or -1,                       shape [frames, agents], int16
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
    touches: wp.array

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
            touches=wp.full((frames, agents), -1, dtype=wp.int16, device=device),
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
        threads: Threads on a CPU at most, 0 for one a core; no more are used than there is work for.
        device: A Warp device.
        first_agent: Number in the crowd of the first of them: a process may have a part of a crowd (`echelon.ranks`).
        crowd_count: How many the whole crowd is; None where this is all of it.
        contact: What it is like when characters touch; None where they pass through each other, as they do if the
            character has no capsules.

    State, parameters and origins are of these agents, by index among them. What agents see of one another, and the
    commands, are by number in the crowd; the engine writes and reads the rows of its own:

    Attributes:
        public: What agents see of one another by name, each of shape [crowd]: "positions" [m] and "velocities" [m/s]
            of the root in the world (vec3), "fallen", 1 for those who have and 2 while they get up (int32).
            Who has been removed is nowhere: the position is not finite. With contact also "places" (vec3d),
            "attitudes" (quat), "spins" (vec3) and "bearings" (int32); see `ghosts.PublicMotion`.
        command: Shape [crowd, commands].
        mine: Which rows of these are this engine's.
        team: Its threads, which the group layer shares.
        meetings: Whom its agents meet; None without contact.
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
        first_agent: int = 0,
        crowd_count: int | None = None,
        contact: ContactSettings | None = None,
    ) -> None:
        start_warp()
        cuda = device.startswith("cuda")
        lanes = 1 if cuda else lanes or host_lanes()
        if substeps % tick:
            raise ValueError(f"{substeps} substeps are not a whole number of ticks of {tick}")
        self.character = character
        self.terrain = terrain
        self.agent_count = agent_count
        self.first_agent = first_agent
        self.crowd_count = agent_count if crowd_count is None else crowd_count
        self.mine = slice(first_agent, first_agent + agent_count)
        if not 0 <= first_agent <= self.crowd_count - agent_count:
            raise ValueError(f"agents {first_agent} to {first_agent + agent_count - 1} are not of {self.crowd_count}")
        self.frame_rate = frame_rate
        self.substeps = substeps
        self.tick = tick
        self.lanes = lanes
        self.device = device
        self.step = 1.0 / (frame_rate * substeps)
        bumper = bumper_of(character, self.step) if contact is not None else None
        self.program = compiled_program(
            character, self.step, tick * self.step, integrator, Target(lanes, cuda), terrain.level, bumper
        )
        self.layout = self.program.layout
        self.block_count = -(-agent_count // lanes)
        self._kernel = frame_kernel(self.program, terrain.look_up, type_of(terrain.data), terrain.rough)
        body = character.body

        def zeros(count: int, dtype: Any = wp.float32) -> wp.array:
            return wp.zeros((self.block_count, max(count, 1), lanes), dtype=dtype, device=device)

        self.state = zeros(self.layout.size)
        self.parameters = zeros(len(character.parameters))
        crowd = self.crowd_count
        self.command = wp.zeros((crowd, max(len(character.commands), 1)), dtype=wp.float32, device=device)
        self._command_lanes = zeros(len(character.commands))
        self.public: dict[str, wp.array] = {
            "positions": wp.zeros(crowd, dtype=wp.vec3, device=device),
            "velocities": wp.zeros(crowd, dtype=wp.vec3, device=device),
            "fallen": wp.zeros(crowd, dtype=wp.int32, device=device),
        }
        self.meetings: Meetings | None = None
        if bumper is not None and contact is not None:
            self.meetings = Meetings(
                bumper,
                contact,
                gravity=character.body.gravity,
                substep=self.step,
                frame=1.0 / frame_rate,
                shape=(self.block_count, lanes),
                agents=(first_agent, agent_count, crowd),
                device=device,
            )
            self.public |= self.meetings.public
        self.origins = wp.zeros((self.block_count * lanes, 3), dtype=wp.float64, device=device)
        self._backup = zeros(self.layout.size)
        self._places = zeros(3 * len(self.program.located_sites))
        self._planes = zeros(PLANE_SIZE * len(body.contacts))
        self._seen = zeros(self.program.seen_size)
        self._event_places = wp.array(
            [self.layout.memory[name] for name in character.events] or [0], dtype=int, device=device
        )
        self.team = Team(self._worthwhile_threads(threads))
        self._graphs: Graphs | None = None
        # Slot of the chunk and number of ticks of the next frame: read by the kernel, so that launches never change.
        self._scripts = wp.zeros((1, 1), dtype=wp.float32, device=device)
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
        host[self.mine, self.character.commands.index(name)] = values
        self.command.assign(host)

    def set_scripts(self, scripts: np.ndarray, which: np.ndarray) -> None:
        """What characters with scripts do; everybody begins at the first row of theirs.

        Tables of another shape than before need a chunk to be bound anew.

        Args:
            scripts: Tables of equally many rows, shape [scripts, rows, row size] (see `scripts.ScriptLayout`).
            which: Which of them each agent follows, shape [agents].
        """
        count, rows, size = scripts.shape
        if count * rows > LARGEST_ROW:
            raise ValueError(f"{count} scripts of {rows} rows: at most {LARGEST_ROW} rows can be told apart")
        table = scripts.reshape(count * rows, size)
        if self._scripts.shape == table.shape:
            # In place, where launches that were captured look for it.
            self._scripts.assign(table.astype(np.float32))
        else:
            self._scripts = wp.array(table, dtype=wp.float32, device=self.device)
        self.set_memory("first_row", np.asarray(which) * rows)
        self.set_memory("row", np.full(self.agent_count, NOT_BEGUN))

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
        return self._gather(self.state, self.layout.frozen, 1)[:, 0] == LOST

    @property
    def positions(self) -> wp.array:
        """Of roots in the world [m], vec3, shape [crowd]."""
        return self.public["positions"]

    @property
    def velocities(self) -> wp.array:
        """Of roots in the world [m/s], vec3, shape [crowd]."""
        return self.public["velocities"]

    @property
    def fallen(self) -> wp.array:
        """1 for those who have fallen, int32, shape [crowd]."""
        return self.public["fallen"]

    def full_state(self) -> dict[str, np.ndarray]:
        """Everything that the next frame depends on: for checkpoints, and for comparing runs.

        Each array has a row for each of this engine's agents. What an agent sees of others is in their rows.
        """
        return {
            "state": self._gather(self.state, 0, self.layout.size),
            "parameters": self._gather(self.parameters, 0, max(len(self.program.parameter_names), 1)),
            "origins": self.origins.numpy()[: self.agent_count].copy(),
            "command": self.command.numpy()[self.mine].copy(),
            **{f"public.{name}": array.numpy()[self.mine].copy() for name, array in self.public.items()},
            **({} if self.meetings is None else {"pressed": self.meetings.pressed.numpy()[: self.agent_count].copy()}),
        }

    def load_full_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Back to what `full_state` gave, of the whole crowd: with a row for each agent of it."""
        mine = {name: array[self.mine] for name, array in arrays.items()}
        self._assign(self.state, 0, mine["state"], self.layout.size)
        self._assign(self.parameters, 0, mine["parameters"], max(len(self.program.parameter_names), 1))
        self.set_origins(mine["origins"])
        self.command.assign(arrays["command"])
        if self.meetings is not None:
            self.meetings.set_pressed(mine["pressed"])
        for name, array in self.public.items():
            array.assign(arrays[f"public.{name}"])

    # ---- frames ----------------------------------------------------------------------------------------------------
    def load(self) -> None:
        """Load the frame kernel, compiling it where nobody has compiled it before."""
        wp.load_module(self._kernel.module, device=self.device)
        if self.meetings is not None:
            self.meetings.load()

    def _worthwhile_threads(self, threads: int) -> int:
        """As many of the threads (0 for one a core) as there is work for: waking one takes time, too."""
        if self.device != "cpu":
            return 1
        work = self.agent_count * self.substeps * self.program.substep_operations
        return max(1, min(threads or available_cores(), work // THREAD_WORK, self.block_count))

    def bind(self, chunk: ChunkArrays) -> None:
        """Choose the chunk that frames are observed into, and capture the launches, so that repeating them is cheap."""
        self._chunk = chunk
        self.load()
        meetings = self.meetings or NobodyMet(self.device)
        outputs = [self.state, self.origins, self._command_lanes, self._backup, self._places, self._planes, self._seen]
        outputs += [meetings.ghosts, self.positions, self.velocities, self.fallen, *meetings.public.values()]
        outputs += [meetings.pressed]
        outputs += [chunk.poses, chunk.origins, chunk.velocities]
        outputs += [chunk.desired, chunk.measures, chunk.phases, chunk.contacts, chunk.fallen, chunk.frozen]
        outputs += [chunk.events, chunk.touches]

        def launch(first: int, count: int) -> None:
            inputs = [first, self.agent_count, self.first_agent, self.tick, self._clock, self.terrain.data]
            inputs += [self._event_places, self.parameters, self.command, self._scripts]
            inputs += [meetings.law, meetings.counts, meetings.indices]
            wp.launch(self._kernel, count, inputs=inputs, outputs=outputs, device=self.device, block_dim=64)

        phases: list[Phase] = [[partial(launch, *part) for part in dealt(self.block_count, self.team.size)]]
        if self.meetings is not None:
            phases = [*self.meetings.phases(self.team.size, self.state, self.origins, self.velocities), *phases]
        self._graphs = Graphs(phases, self.device)

    def advance(self, slot: int, *, observe_only: bool = False) -> None:
        """Carry everybody through one frame and leave what is seen in a slot of the bound chunk.

        Args:
            slot: Frame within the chunk.
            observe_only: Do not move; only observe (the first frame of a run).
        """
        if self._graphs is None:
            raise ValueError("there is no chunk to observe into; bind one first")
        ticks = 0 if observe_only else self.substeps // self.tick
        if self._clock_on_host is not None:
            self._clock_on_host[:] = (slot, ticks)
        else:
            self._clock.assign(np.array([slot, ticks], dtype=np.int32))
        self._graphs.replay(self.team)

    def close(self) -> None:
        """Let the threads go."""
        self.team.close()


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
