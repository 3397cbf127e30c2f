"""The frame loop: see, want, act, record.

    frame k                                                              frame k+1
    see --> want --> act: substeps of control, contact and dynamics --> record --> see ...

Characters meet only at frame boundaries, through what the group layer sees of them there (`scene`); within a frame
each is alone with the ground beneath it and one kernel launch carries everybody across
(`echelon.warp_kernels.frame`). What happened streams to a recording, in chunks with the full state at the start of
each, so that a run which is killed goes on to the same bytes.

Where several ranks simulate one crowd (`echelon.ranks`), each has some of the agents, and after acting all tell each
other what others see of them: that is all that passes between them in a frame. What a scene does for everybody (the
hash grid, the collie) every rank does alike, from the same numbers.

Time is a whole number of frames; frame 0 is the start.
"""

from __future__ import annotations

import colorsys
import hashlib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from echelon.agents.characters import character_named
from echelon.ranks import Ranks
from echelon.recording import EVENT_DTYPE, EVENT_NAMES, Cast, Recording, RecordingWriter
from echelon.scenario import Scenario
from echelon.simulation.cost import PhaseClock, RunCost
from echelon.simulation.fallen import Fallen
from echelon.simulation.field import Field
from echelon.simulation.road import Road
from echelon.simulation.scene import Scene, SceneFrames
from echelon.simulation.telling import Telling
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.meetings import ContactSettings
from echelon.warp_kernels.replay import Share
from echelon.warp_kernels.start import checked_device

Progress = Callable[[int, int], None]
"""Called with (frames done, frames at most)."""

GOLDEN_RATIO = 0.6180339887498949


class Simulation:
    """A scenario that is running: who, where, what they want, and the frame that it has come to.

    Attributes:
        scenario: What runs.
        character: Who.
        scene: Where, and what they want.
        engine: Everybody's bodies.
        fallen: What becomes of those who fall.
        frame: Frames done; frame 0, the start, counts as one once it has been observed.
        counts: How often each kind of event has happened, in chunks that are done.
        measure_sums: Of each measure over the frames of these chunks, shape [agents, measures], of this rank's agents.
        ranks: Who simulate the crowd together.
        clock: Seconds spent in each phase so far: `clock.seconds`, by `echelon.simulation.cost.PHASES`.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        threads: int | None = None,
        device: str = "cpu",
        world: Mapping[str, Any] | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        """Put everybody where they start.

        Args:
            scenario: What to run.
            threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
            device: A Warp device, "cpu", "cuda" or "cuda:1".
            world: That of the recording to go on with; None makes it anew.
            ranks: Who simulate the crowd together; None for this process alone.

        Raises:
            InputError: There are more ranks than agents, or the scenario asks for what is not there, or there is no
                such device.
        """
        device = checked_device(device)
        self.ranks = ranks or Ranks()
        self.ranks.check(scenario.crowd.count)
        first, count = self.ranks.part(scenario.crowd.count)
        crowd, settings = scenario.crowd, scenario.engine
        self.scenario = scenario
        self.character = character_named(crowd.character)
        self.scene: Scene = Road(scenario, device, world) if scenario.on_road else Field(scenario, device)
        needs = self.character.steps_per_second, self.character.steps_per_tick
        substeps, tick = settings.stride(scenario.frame_rate, *needs)
        self.engine = Engine(
            self.character,
            count,
            self.scene.terrain,
            frame_rate=scenario.frame_rate,
            substeps=substeps,
            tick=tick,
            integrator=settings.integrator,
            lanes=settings.lanes,
            threads=settings.threads if threads is None else threads,
            device=device,
            first_agent=first,
            crowd_count=crowd.count,
            contact=ContactSettings(crowd.restitution, crowd.friction) if crowd.contact else None,
        )
        self.scene.divide(Share(crowd.count, first, count, self.engine.team, self.scene.beyond))
        with self.ranks.first_before_others():
            self.engine.load()
            self.scene.load()
        self._populate()
        self.fallen = Fallen(scenario, self.engine)
        self.frame = 0
        self.counts = dict.fromkeys(EVENT_NAMES, 0)
        self.measure_sums = np.zeros((count, len(self.measure_names)))
        self.clock = PhaseClock()
        self._seen = partial(self.clock.lap, "see")
        public = {f"engine.{name}": array for name, array in self.engine.public.items()}
        public |= {f"scene.{name}": array for name, array in self.scene.public().items()}
        self._tell = Telling(self.ranks, crowd.count, public)

    @property
    def bytes_told(self) -> int:
        """What other ranks are told of one agent, each frame."""
        return self._tell.bytes_per_agent

    @property
    def measure_names(self) -> tuple[str, ...]:
        """What is measured of each agent in each frame: the character's own, then the scene's."""
        return (*self.character.records, *self.scene.measure_names)

    def _populate(self) -> None:
        people, places = self.scene.people(self.character)
        mine = self.engine.mine
        self.engine.set_q(people.q[mine])
        self.engine.set_u(people.u[mine])
        for name, values in people.parameters.items():
            self.engine.set_parameter(name, values[mine])
        for name, values in people.memory.items():
            self.engine.set_memory(name, values[mine])
        self.engine.set_origins(places[mine])

    # ---- state -----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, np.ndarray]:
        """Everything that the next frame depends on, by name; copies. Of agents, those of this rank."""
        return self.shared_state() | self.agent_state()

    def shared_state(self) -> dict[str, np.ndarray]:
        """What there is of the state that is not of single agents; the same on all ranks."""
        scene = {f"scene.{k}": array for k, array in self.scene.state().items() if k not in self.scene.by_agent}
        return scene | {"counts": np.array(list(self.counts.values()), dtype=np.int64)}

    def agent_state(self) -> dict[str, np.ndarray]:
        """What there is of it with a row for each agent, of this rank."""
        mine = self.engine.mine
        engine = {f"engine.{name}": array for name, array in self.engine.full_state().items()}
        scene = {f"scene.{k}": array[mine] for k, array in self.scene.state().items() if k in self.scene.by_agent}
        scene |= {f"fallen.{name}": array for name, array in self.fallen.state().items()}
        return engine | scene | {"measure_sums": self.measure_sums.copy()}

    def load_state(self, state: Mapping[str, np.ndarray], frame: int) -> None:
        """Go on from what `state` gave when ``frame`` was the next; of agents, from that of the whole crowd."""
        parts: dict[str, dict[str, np.ndarray]] = {"engine": {}, "scene": {}, "fallen": {}}
        for name, array in state.items():
            room, _, rest = name.partition(".")
            if rest:
                parts[room][rest] = array
        self.engine.load_full_state(parts["engine"])
        self.scene.load_state(parts["scene"])
        self.fallen.load_state(parts["fallen"])
        self.counts = dict(zip(self.counts, map(int, state["counts"]), strict=True))
        self.measure_sums = np.array(state["measure_sums"][self.engine.mine])
        self.frame = frame
        self.scene.begin()

    def state_hash(self) -> str:
        """SHA-256 of the present state: equal for equal runs, on any number of ranks; all call it at once."""
        digest = hashlib.sha256()
        shared, agents = self.shared_state(), self.agent_state()
        for name in sorted([*shared, *agents]):
            digest.update(name.encode())
            for rows in [shared[name]] if name in shared else self.ranks.in_order(agents[name]):
                digest.update(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)
        return self.ranks.broadcast(digest.hexdigest())

    # ---- frames ----------------------------------------------------------------------------------------------------
    def advance(self, slot: int, seen: SceneFrames) -> None:
        """One frame into a slot: everybody acts on what was wanted before, then sees, and wants anew.

        The first frame is only looked at: nobody has moved yet.
        """
        clock = self.clock
        clock.start()
        if self.frame > 0:
            seen.events += self.fallen.step(self.frame)
        self.engine.advance(slot, observe_only=self.frame == 0)
        clock.lap("act")
        self._tell()
        clock.lap("exchange")
        self.scene.keep_actors(slot, seen)
        clock.lap("record")
        self.scene.step(self.frame, self.engine, self._seen)
        clock.lap("want")
        self.scene.keep(self.frame, slot, seen)
        clock.lap("record")
        self.frame += 1

    def preroll(self) -> None:
        """Simulate the scenario's preroll, unrecorded; frame 0 is where it ends."""
        count = round(self.scenario.shot.preroll * self.scenario.frame_rate)
        if count == 0:
            return
        self.engine.bind(ChunkArrays.allocate(1, self.engine.agent_count, self.character, self.engine.device))
        for frame in range(count):
            if frame > 0:
                self.fallen.step(frame - count)
            self.engine.advance(0, observe_only=frame == 0)
            self._tell()
            self.scene.step(frame - count, self.engine)
        self.scene.begin()

    @property
    def finished(self) -> bool:
        """Whether what the scenario runs until has come about."""
        return self.scene.finished

    def summary(self) -> dict[str, object]:
        """What the run came to; nothing in it depends on the clock. All ranks call it at once."""
        state_hash = self.state_hash()
        sums = self.ranks.gather(self.measure_sums)
        Telling(self.ranks, self.scenario.crowd.count, self.scene.tallies())()
        return self.ranks.broadcast(self._summary(sums, state_hash) if self.ranks.is_first else None)

    def _summary(self, measure_sums: np.ndarray, state_hash: str) -> dict[str, object]:
        last = self.frame - 1
        means = dict(zip(self.measure_names, measure_sums.T / self.frame, strict=True))
        return {
            "frames": self.frame,
            "seconds": last / self.scenario.frame_rate,
            "falls": self.counts["fall"],
            "collisions": self.counts["collision"],
            "contacts": self.counts["contact"],
            "nonfinite": self.counts["nonfinite"],
            **self.fallen.summary(self.counts),
            **self.scene.summary(last, means),
            "state_hash": state_hash,
        }

    def close(self) -> None:
        """Let go of threads."""
        self.engine.close()


def simulate(
    scenario: Scenario,
    *,
    recording: str | Path,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    ranks: Ranks | None = None,
    cost: RunCost | None = None,
) -> Recording:
    """Run a scenario and record it.

    Args:
        scenario: What to run.
        recording: Folder to record into; a recording that is there is replaced.
        threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
        progress: Called after each frame.
        device: A Warp device.
        ranks: Who simulate the crowd together, each calling this with the same arguments and on a file system that all
            see; None for this process alone.
        cost: Gets what the run took.

    Returns:
        The recording.

    Raises:
        InputError: The folder cannot be written, or is something else.
        RecordingFailed: Writing failed on the way; what was written can be resumed.
    """
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device, ranks=ranks)
        stack.callback(simulation.close)
        character = simulation.character
        writer = stack.enter_context(
            RecordingWriter.create(
                recording,
                scenario=scenario.to_dict(),
                frame_rate=scenario.frame_rate,
                frame_limit=scenario.step_count + 1,
                casts=[Cast(character.name, character.body, 0, scenario.crowd.count, colors(scenario.crowd.count))],
                world=simulation.scene.world,
                actors=simulation.scene.actors,
                phase_names=simulation.fallen.phase_names,
                measure_names=simulation.measure_names,
                ranks=ranks,
            )
        )
        simulation.preroll()
        _run(simulation, writer, progress)
        if cost is not None:
            cost.fill_in(simulation.clock, simulation.engine.team.size, simulation.ranks)
    return Recording(recording)


def resume(
    recording: str | Path,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    ranks: Ranks | None = None,
    cost: RunCost | None = None,
) -> Recording:
    """Go on with a run that was interrupted, to the bytes that it would have had.

    Args:
        recording: Its folder.
        threads, progress, device, ranks, cost: As for `simulate`.

    Raises:
        InputError: It is no recording, or is finished.
        RecordingFailed: Writing failed, or this program or machine computes something else than the first did.
    """
    begun = Recording(recording)
    scenario = Scenario.from_dict(begun.scenario, source=str(recording))
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device, world=begun.world, ranks=ranks)
        stack.callback(simulation.close)
        writer, state = RecordingWriter.reopen(recording, ranks)
        stack.enter_context(writer)
        if state is None:
            simulation.preroll()
        else:
            simulation.load_state(state, writer.next_frame)
        _run(simulation, writer, progress)
        if cost is not None:
            cost.fill_in(simulation.clock, simulation.engine.team.size, simulation.ranks)
    return Recording(recording)


def _run(simulation: Simulation, writer: RecordingWriter, progress: Progress | None) -> None:
    """From the present frame to the end, a chunk at a time; what has been simulated is written meanwhile."""
    total = writer.frame_limit
    engine = simulation.engine
    length = min(writer.chunk_frames, total)
    chunk = ChunkArrays.allocate(length, engine.agent_count, engine.character, engine.device)
    engine.bind(chunk)
    while simulation.frame < total and not simulation.finished:
        simulation.clock.start()
        first, frozen = simulation.frame, engine.frozen
        writer.begin_chunk(simulation.shared_state(), simulation.agent_state())
        seen = SceneFrames.allocate(length, simulation.scene, engine.agent_count)
        simulation.clock.lap("record")
        count = given = 0
        going_on = True
        while going_on:
            simulation.advance(count, seen)
            count += 1
            if progress is not None:
                progress(simulation.frame, total)
            going_on = count < length and simulation.frame < total and not simulation.finished
            if count - given == writer.piece_frames or not going_on:
                simulation.clock.start()
                writer.extend(_frames(chunk, seen, slice(given, count), engine.character))
                simulation.clock.lap("record")
                given = count
        simulation.clock.start()
        events = _events(chunk, seen, engine, first, count, frozen)
        kinds = np.bincount(events["kind"], minlength=len(EVENT_NAMES))
        for kind, found in enumerate(simulation.ranks.sum(kinds)):
            simulation.counts[EVENT_NAMES[kind]] += int(found)
        measures = _measures(chunk, seen, slice(count), engine.character)
        simulation.measure_sums += measures.sum(axis=0, dtype=np.float64)
        writer.end_chunk(events)
        simulation.clock.lap("record")
    writer.finish(simulation.summary())
    simulation.clock.seconds["write"] = writer.seconds


def _frames(chunk: ChunkArrays, seen: SceneFrames, part: slice, character: Character) -> dict[str, np.ndarray]:
    """Some frames of a chunk under the names that the recording has for them."""
    arrays = {
        "link_poses": chunk.poses,
        "origins": chunk.origins,
        "velocities": chunk.velocities,
        "phases": chunk.phases,
    }
    frames = {name: array[part].numpy() for name, array in arrays.items()}
    for name, array in (("contacts", chunk.contacts), ("fallen", chunk.fallen), ("frozen", chunk.frozen)):
        frames[name] = array[part].numpy().view(np.bool_)
    frames["desired_velocities"] = chunk.desired[part].numpy()[:, :, :2]
    frames["measures"] = _measures(chunk, seen, part, character)
    return frames | {"in_corral": seen.in_corral[part], "actor_poses": seen.actor_poses[part]}


def _measures(chunk: ChunkArrays, seen: SceneFrames, part: slice, character: Character) -> np.ndarray:
    """What is measured in some frames of a chunk, shape [frames, agents, measures]."""
    own = chunk.measures[part].numpy()[:, :, : len(character.records)]
    return np.concatenate([own, seen.measures[part]], axis=2)


def _events(
    chunk: ChunkArrays, seen: SceneFrames, engine: Engine, first: int, count: int, frozen_before: np.ndarray
) -> np.ndarray:
    """What happened in a chunk to an engine's agents, as the recording's table."""
    character = engine.character
    substeps = chunk.events.numpy()[:count, :, : len(character.events)]
    frame, agent, event = _where(substeps >= 0)
    own = np.zeros(len(frame), EVENT_DTYPE)
    own["frame"], own["agent"], own["substep"] = frame + first, agent, substeps[frame, agent, event]
    own["kind"] = np.array([EVENT_NAMES.index(name) for name in character.events], np.uint8)[event]
    touches = chunk.touches.numpy()[:count]
    frame, agent = _where(touches >= 0)
    met = np.zeros(len(frame), EVENT_DTYPE)
    met["frame"], met["agent"], met["substep"] = frame + first, agent, touches[frame, agent]
    met["kind"] = EVENT_NAMES.index("contact")
    frozen = chunk.frozen.numpy()[:count].view(np.bool_)
    frame, agent = _where(frozen & ~np.concatenate([frozen_before[None], frozen[:-1]]))
    lost = np.zeros(len(frame), EVENT_DTYPE)
    lost["frame"], lost["agent"], lost["kind"] = frame + first, agent, EVENT_NAMES.index("nonfinite")
    found = np.concatenate([own, met, lost])
    found["agent"] += engine.first_agent
    return np.concatenate([found, np.array(seen.events, EVENT_DTYPE)])


def _where(chosen: np.ndarray) -> tuple[np.ndarray, ...]:
    """Indices of what is true, along each dimension; several times as fast as `numpy.nonzero` where little is."""
    return np.unravel_index(np.flatnonzero(chosen), chosen.shape)


def colors(count: int) -> np.ndarray:
    """A colour for each individual that its neighbours in the list do not have: linear RGB, shape [count, 3]."""
    # Hues a golden section apart fill the circle evenly however many there are.
    hues = (np.arange(count) * GOLDEN_RATIO + 0.03) % 1.0
    values = 0.95 - 0.12 * (np.arange(count) % 3)
    return np.array([colorsys.hsv_to_rgb(h, 0.72, v) for h, v in zip(hues, values, strict=True)])
