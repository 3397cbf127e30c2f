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
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.ranks import Ranks
from echelon.recording import EVENT_DTYPE, EVENT_NAMES, Cast, Recording, RecordingWriter
from echelon.scenario import Scenario
from echelon.simulation.casts import casts_of, joined_states, share_public
from echelon.simulation.cost import PhaseClock, RunCost
from echelon.simulation.fallen import Fallen
from echelon.simulation.field import Field
from echelon.simulation.gym import Gym
from echelon.simulation.road import Road
from echelon.simulation.roles import with_scripts
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
        casts: Who.
        scene: Where, and what they want.
        engines: Everybody's bodies, an engine for each cast that has agents here; those of one crowd share what agents
            see of one another.
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
        scenario = with_scripts(scenario) if scenario.performs else scenario
        self.scenario = scenario
        self.mine = slice(first, first + count)
        self.casts = casts_of(scenario)
        if scenario.performs:
            self.scene: Scene = Gym(scenario, self.casts, device)
        else:
            self.scene = Road(scenario, device, world) if scenario.on_road else Field(scenario, device)
        parts = [(cast, range(max(cast.first, first), min(cast.agents.stop, first + count))) for cast in self.casts]
        threads = scenario.engine.threads if threads is None else threads
        self.engines = tuple(self._engine_of(cast.character, part, threads, device) for cast, part in parts if part)
        share_public(self.engines)
        self.scene.divide(Share(scenario.crowd.count, first, count, self.engine.team, self.scene.beyond))
        with self.ranks.first_before_others():
            for engine in self.engines:
                engine.load()
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
        self._tell = Telling(self.ranks, scenario.crowd.count, public)

    def _engine_of(self, character: Character, agents: range, threads: int, device: str) -> Engine:
        """The engine of some agents of the crowd, by their numbers."""
        crowd, settings = self.scenario.crowd, self.scenario.engine
        needs = character.steps_per_second, character.steps_per_tick
        substeps, tick = settings.stride(self.scenario.frame_rate, *needs)
        return Engine(
            character,
            len(agents),
            self.scene.terrain,
            frame_rate=self.scenario.frame_rate,
            substeps=substeps,
            tick=tick,
            integrator=settings.integrator,
            lanes=settings.lanes,
            threads=threads,
            device=device,
            first_agent=agents.start,
            crowd_count=crowd.count,
            contact=ContactSettings(crowd.restitution, crowd.friction) if crowd.contact else None,
        )

    @property
    def engine(self) -> Engine:
        """The engine of the first cast, the only one of most crowds."""
        return self.engines[0]

    @property
    def character(self) -> Character:
        """Who the first cast are; phases, events and records are the same for all."""
        return self.casts[0].character

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
        for engine in self.engines:
            engine.set_q(people.q[engine.mine])
            engine.set_u(people.u[engine.mine])
            for name, values in people.parameters.items():
                engine.set_parameter(name, values[engine.mine])
            for name, values in people.memory.items():
                engine.set_memory(name, values[engine.mine])
            engine.set_origins(places[engine.mine])
        self.scene.prepare(self.engines)

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
        engine = {f"engine.{name}": array for name, array in joined_states(self.engines).items()}
        scene = {f"scene.{k}": array[self.mine] for k, array in self.scene.state().items() if k in self.scene.by_agent}
        scene |= {f"fallen.{name}": array for name, array in self.fallen.state().items()}
        return engine | scene | {"measure_sums": self.measure_sums.copy()}

    def load_state(self, state: Mapping[str, np.ndarray], frame: int) -> None:
        """Go on from what `state` gave when ``frame`` was the next; of agents, from that of the whole crowd."""
        parts: dict[str, dict[str, np.ndarray]] = {"engine": {}, "scene": {}, "fallen": {}}
        for name, array in state.items():
            room, _, rest = name.partition(".")
            if rest:
                parts[room][rest] = array
        for engine in self.engines:
            engine.load_full_state(parts["engine"])
        self.scene.load_state(parts["scene"])
        self.fallen.load_state(parts["fallen"])
        self.counts = dict(zip(self.counts, map(int, state["counts"]), strict=True))
        self.measure_sums = np.array(state["measure_sums"][self.mine])
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
        for engine in self.engines:
            engine.advance(slot, observe_only=self.frame == 0)
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

    def bind(self, frames: int) -> tuple[ChunkArrays, ...]:
        """Let each engine observe into a chunk of so many frames; returns the chunks, engine by engine."""
        chunks = []
        for engine in self.engines:
            chunks.append(ChunkArrays.allocate(frames, engine.agent_count, engine.character, engine.device))
            engine.bind(chunks[-1])
        return tuple(chunks)

    def preroll(self) -> None:
        """Simulate the scenario's preroll, unrecorded; frame 0 is where it ends."""
        count = round(self.scenario.shot.preroll * self.scenario.frame_rate)
        if count == 0:
            return
        self.bind(1)
        for frame in range(count):
            if frame > 0:
                self.fallen.step(frame - count)
            for engine in self.engines:
                engine.advance(0, observe_only=frame == 0)
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
        for engine in self.engines:
            engine.close()


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
        writer = stack.enter_context(
            RecordingWriter.create(
                recording,
                scenario=simulation.scenario.to_dict(),
                frame_rate=scenario.frame_rate,
                frame_limit=scenario.step_count + 1,
                casts=_recorded_casts(simulation),
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
            cost.fill_in(simulation.clock, max(e.team.size for e in simulation.engines), simulation.ranks)
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
            cost.fill_in(simulation.clock, max(e.team.size for e in simulation.engines), simulation.ranks)
    return Recording(recording)


def _run(simulation: Simulation, writer: RecordingWriter, progress: Progress | None) -> None:
    """From the present frame to the end, a chunk at a time; what has been simulated is written meanwhile."""
    total = writer.frame_limit
    length = min(writer.chunk_frames, total)
    chunks = simulation.bind(length)
    own_count = sum(engine.agent_count for engine in simulation.engines)
    while simulation.frame < total and not simulation.finished:
        simulation.clock.start()
        first, frozen = simulation.frame, [engine.frozen for engine in simulation.engines]
        writer.begin_chunk(simulation.shared_state(), simulation.agent_state())
        seen = SceneFrames.allocate(length, simulation.scene, own_count)
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
                writer.extend(_frames(chunks, seen, slice(given, count), simulation.character))
                simulation.clock.lap("record")
                given = count
        simulation.clock.start()
        found = [
            _events(chunk, engine, first, count, before)
            for chunk, engine, before in zip(chunks, simulation.engines, frozen, strict=True)
        ]
        events = np.concatenate([*found, np.array(seen.events, EVENT_DTYPE)])
        kinds = np.bincount(events["kind"], minlength=len(EVENT_NAMES))
        for kind, number in enumerate(simulation.ranks.sum(kinds)):
            simulation.counts[EVENT_NAMES[kind]] += int(number)
        measures = _measures(chunks, seen, slice(count), simulation.character)
        simulation.measure_sums += measures.sum(axis=0, dtype=np.float64)
        writer.end_chunk(events)
        simulation.clock.lap("record")
    writer.finish(simulation.summary())
    simulation.clock.seconds["write"] = writer.seconds


def _recorded_casts(simulation: Simulation) -> list[Cast]:
    """The casts as the recording has them, each individual in a colour of its own."""
    tones = colors(
        simulation.scenario.crowd.count,
        beside_skin=any(isinstance(cast.character, Gymnast) for cast in simulation.casts),
    )
    return [
        Cast(cast.name, cast.character.body, cast.first, cast.count, tones[cast.first : cast.agents.stop])
        for cast in simulation.casts
    ]


def _frames(
    chunks: Sequence[ChunkArrays], seen: SceneFrames, part: slice, character: Character
) -> dict[str, np.ndarray]:
    """Some frames of a chunk, of all engines, under the names that the recording has for them."""
    names = {name: name for name in ("origins", "velocities", "phases")} | {"link_poses": "poses"}
    frames = {name: _rows(chunks, of, part) for name, of in names.items()}
    for name in ("contacts", "fallen", "frozen"):
        frames[name] = _rows(chunks, name, part).view(np.bool_)
    frames["desired_velocities"] = _velocities(_rows(chunks, "desired", part))
    frames["measures"] = _measures(chunks, seen, part, character)
    return frames | {"in_corral": seen.in_corral[part], "actor_poses": seen.actor_poses[part]}


def _rows(chunks: Sequence[ChunkArrays], name: str, part: slice) -> np.ndarray:
    """An array of some frames of a chunk, with the agents of all engines, shape [frames, agents, ...]."""
    rows = [getattr(chunk, name)[part].numpy() for chunk in chunks]
    return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=1)


def _velocities(desired: np.ndarray) -> np.ndarray:
    """The first two of the commands, shape [frames, agents, 2]; zero for characters that take none."""
    found = desired[:, :, :2]
    missing = 2 - found.shape[2]
    return np.pad(found, ((0, 0), (0, 0), (0, missing))) if missing else found


def _measures(chunks: Sequence[ChunkArrays], seen: SceneFrames, part: slice, character: Character) -> np.ndarray:
    """What is measured in some frames of a chunk, shape [frames, agents, measures]."""
    own = _rows(chunks, "measures", part)[:, :, : len(character.records)]
    return np.concatenate([own, seen.measures[part]], axis=2)


def _events(chunk: ChunkArrays, engine: Engine, first: int, count: int, frozen_before: np.ndarray) -> np.ndarray:
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
    return found


def _where(chosen: np.ndarray) -> tuple[np.ndarray, ...]:
    """Indices of what is true, along each dimension; several times as fast as `numpy.nonzero` where little is."""
    return np.unravel_index(np.flatnonzero(chosen), chosen.shape)


def colors(count: int, beside_skin: bool = False) -> np.ndarray:
    """A colour for each individual that its neighbours in the list do not have: linear RGB, shape [count, 3].

    Args:
        count: How many.
        beside_skin: Whether it is worn by people whose skin shows: none is then taken for skin.
    """
    # Hues a golden section apart fill the circle evenly however many there are.
    hues = (np.arange(count) * GOLDEN_RATIO + 0.03) % 1.0
    values = 0.95 - 0.12 * (np.arange(count) % 3)
    if beside_skin:
        # From crimson over blue to green, and deeper.
        return np.array([colorsys.hsv_to_rgb(0.98 - 0.68 * h, 0.9, 0.6 * v) for h, v in zip(hues, values, strict=True)])
    return np.array([colorsys.hsv_to_rgb(h, 0.72, v) for h, v in zip(hues, values, strict=True)])
