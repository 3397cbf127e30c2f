"""The frame loop: see, want, act, record.

    frame k                                                              frame k+1
    see --> want --> act: substeps of control, contact and dynamics --> record --> see ...

Characters meet only at frame boundaries, through what the group layer sees of them there (`scene`); within a frame
each is alone with the ground beneath it and one kernel launch carries everybody across
(`echelon.warp_kernels.frame`). What happened streams to a recording a chunk at a time, each chunk with the full state
at its start, so that a run which is killed goes on to the same bytes.

Time is a whole number of frames; frame 0 is the start.
"""

from __future__ import annotations

import colorsys
import hashlib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from echelon.agents.characters import character_named
from echelon.recording import EVENT_DTYPE, EVENT_NAMES, Cast, Recording, RecordingWriter
from echelon.scenario import Scenario
from echelon.simulation.field import Field
from echelon.simulation.road import Road
from echelon.simulation.scene import Scene, SceneFrames
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.start import start_warp

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
        frame: Frames done; frame 0, the start, counts as one once it has been observed.
        counts: How often each kind of event has happened, in chunks that are done.
        measure_sums: Of each measure over the frames of these chunks, shape [agents, measures].
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        threads: int | None = None,
        device: str = "cpu",
        world: Mapping[str, Any] | None = None,
    ) -> None:
        """Put everybody where they start.

        Args:
            scenario: What to run.
            threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
            device: A Warp device, "cpu" or "cuda:0".
            world: That of the recording to go on with; None makes it anew.
        """
        start_warp()
        crowd, settings = scenario.crowd, scenario.engine
        self.scenario = scenario
        self.character = character_named(crowd.character)
        self.scene: Scene = Road(scenario, device, world) if scenario.on_road else Field(scenario, device)
        needs = self.character.steps_per_second, self.character.steps_per_tick
        substeps, tick = settings.stride(scenario.frame_rate, *needs)
        self.engine = Engine(
            self.character,
            crowd.count,
            self.scene.terrain,
            frame_rate=scenario.frame_rate,
            substeps=substeps,
            tick=tick,
            integrator=settings.integrator,
            lanes=settings.lanes,
            threads=settings.threads if threads is None else threads,
            device=device,
        )
        self._populate()
        self.frame = 0
        self.counts = dict.fromkeys(EVENT_NAMES, 0)
        self.measure_sums = np.zeros((crowd.count, len(self.measure_names)))

    @property
    def measure_names(self) -> tuple[str, ...]:
        """What is measured of each agent in each frame: the character's own, then the scene's."""
        return (*self.character.records, *self.scene.measure_names)

    def _populate(self) -> None:
        people, places = self.scene.people(self.character)
        self.engine.set_q(people.q)
        self.engine.set_u(people.u)
        for name, values in people.parameters.items():
            self.engine.set_parameter(name, values)
        for name, values in people.memory.items():
            self.engine.set_memory(name, values)
        self.engine.set_origins(places)

    # ---- state -----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, np.ndarray]:
        """Everything that the next frame depends on, by name; copies."""
        engine = {f"engine.{name}": array for name, array in self.engine.full_state().items()}
        scene = {f"scene.{name}": array for name, array in self.scene.state().items()}
        counts = np.array(list(self.counts.values()), dtype=np.int64)
        return engine | scene | {"counts": counts, "measure_sums": self.measure_sums.copy()}

    def load_state(self, state: Mapping[str, np.ndarray], frame: int) -> None:
        """Go on from what `state` gave when ``frame`` was the next."""
        parts: dict[str, dict[str, np.ndarray]] = {"engine": {}, "scene": {}}
        for name, array in state.items():
            room, _, rest = name.partition(".")
            if rest:
                parts[room][rest] = array
        self.engine.load_full_state(parts["engine"])
        self.scene.load_state(parts["scene"])
        self.counts = dict(zip(self.counts, map(int, state["counts"]), strict=True))
        self.measure_sums = np.array(state["measure_sums"])
        self.frame = frame
        self.scene.begin()

    def state_hash(self) -> str:
        """SHA-256 of the present state: equal for equal runs."""
        digest = hashlib.sha256()
        for name, array in sorted(self.state().items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    # ---- frames ----------------------------------------------------------------------------------------------------
    def advance(self, slot: int, seen: SceneFrames) -> None:
        """One frame into a slot: everybody acts on what was wanted before, then sees, and wants anew.

        The first frame is only looked at: nobody has moved yet.
        """
        self.engine.advance(slot, observe_only=self.frame == 0)
        self.scene.keep_actors(slot, seen)
        self.scene.step(self.frame, self.engine)
        self.scene.keep(self.frame, slot, seen)
        self.frame += 1

    def preroll(self) -> None:
        """Simulate the scenario's preroll, unrecorded; frame 0 is where it ends."""
        count = round(self.scenario.shot.preroll * self.scenario.frame_rate)
        if count == 0:
            return
        self.engine.bind(ChunkArrays.allocate(1, self.engine.agent_count, self.character, self.engine.device))
        for frame in range(count):
            self.engine.advance(0, observe_only=frame == 0)
            self.scene.step(frame - count, self.engine)
        self.scene.begin()

    @property
    def finished(self) -> bool:
        """Whether what the scenario runs until has come about."""
        return self.scene.finished

    def summary(self) -> dict[str, object]:
        """What the run came to; nothing in it depends on the clock."""
        last = self.frame - 1
        return {
            "frames": self.frame,
            "seconds": last / self.scenario.frame_rate,
            "falls": self.counts["fall"],
            "collisions": self.counts["collision"],
            "nonfinite": self.counts["nonfinite"],
            **self.scene.summary(last, dict(zip(self.measure_names, self.measure_sums.T / self.frame, strict=True))),
            "state_hash": self.state_hash(),
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
) -> Recording:
    """Run a scenario and record it.

    Args:
        scenario: What to run.
        recording: Folder to record into; a recording that is there is replaced.
        threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
        progress: Called after each frame.
        device: A Warp device.

    Returns:
        The recording.

    Raises:
        InputError: The folder cannot be written, or is something else.
        RecordingFailed: Writing failed on the way; what was written can be resumed.
    """
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device)
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
                phase_names=character.phase_names,
                measure_names=simulation.measure_names,
            )
        )
        simulation.preroll()
        _run(simulation, writer, progress)
    return Recording(recording)


def resume(
    recording: str | Path,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> Recording:
    """Go on with a run that was interrupted, to the bytes that it would have had.

    Args:
        recording: Its folder.
        threads, progress, device: As for `simulate`.

    Raises:
        InputError: It is no recording, or is finished.
        RecordingFailed: Writing failed, or this program or machine computes something else than the first did.
    """
    begun = Recording(recording)
    scenario = Scenario.from_dict(begun.scenario, source=str(recording))
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device, world=begun.world)
        stack.callback(simulation.close)
        writer, state = RecordingWriter.reopen(recording)
        stack.enter_context(writer)
        if state is None:
            simulation.preroll()
        else:
            simulation.load_state(state, writer.next_frame)
        _run(simulation, writer, progress)
    return Recording(recording)


def _run(simulation: Simulation, writer: RecordingWriter, progress: Progress | None) -> None:
    """From the present frame to the end, a chunk at a time; while one is written the next is simulated."""
    total = writer.frame_limit
    engine = simulation.engine
    length = min(writer.chunk_frames, total)
    chunks = [ChunkArrays.allocate(length, engine.agent_count, engine.character, engine.device) for _ in range(2)]
    turn = 0
    while simulation.frame < total and not simulation.finished:
        first, state, frozen = simulation.frame, simulation.state(), engine.frozen
        chunk, seen = chunks[turn], SceneFrames.allocate(length, simulation.scene, engine.agent_count)
        engine.bind(chunk)
        count = 0
        while count < length and simulation.frame < total and not simulation.finished:
            simulation.advance(count, seen)
            count += 1
            if progress is not None:
                progress(simulation.frame, total)
        events = _events(chunk, seen, engine.character, first, count, frozen)
        for kind, found in enumerate(np.bincount(events["kind"], minlength=len(EVENT_NAMES))):
            simulation.counts[EVENT_NAMES[kind]] += int(found)
        frames = _frames(chunk, seen, count, engine.character)
        simulation.measure_sums += frames["measures"].sum(axis=0, dtype=np.float64)
        writer.append(frames, state, events)
        turn = 1 - turn
    writer.finish(simulation.summary())


def _frames(chunk: ChunkArrays, seen: SceneFrames, count: int, character: Character) -> dict[str, np.ndarray]:
    """The first ``count`` frames of a chunk under the names that the recording has for them."""
    arrays = {
        "link_poses": chunk.poses,
        "origins": chunk.origins,
        "velocities": chunk.velocities,
        "phases": chunk.phases,
    }
    frames = {name: array.numpy()[:count] for name, array in arrays.items()}
    for name, array in (("contacts", chunk.contacts), ("fallen", chunk.fallen), ("frozen", chunk.frozen)):
        frames[name] = array.numpy()[:count].view(np.bool_)
    frames["desired_velocities"] = chunk.desired.numpy()[:count, :, :2]
    own = chunk.measures.numpy()[:count, :, : len(character.records)]
    frames["measures"] = np.concatenate([own, seen.measures[:count]], axis=2)
    return frames | {"in_corral": seen.in_corral[:count], "actor_poses": seen.actor_poses[:count]}


def _events(
    chunk: ChunkArrays, seen: SceneFrames, character: Character, first: int, count: int, frozen_before: np.ndarray
) -> np.ndarray:
    """What happened in a chunk, as the recording's table."""
    substeps = chunk.events.numpy()[:count, :, : len(character.events)]
    frame, agent, event = np.nonzero(substeps >= 0)
    own = np.zeros(len(frame), EVENT_DTYPE)
    own["frame"], own["agent"], own["substep"] = frame + first, agent, substeps[frame, agent, event]
    own["kind"] = np.array([EVENT_NAMES.index(name) for name in character.events], np.uint8)[event]
    frozen = chunk.frozen.numpy()[:count].astype(np.int8)
    frame, agent = np.nonzero(np.diff(frozen, axis=0, prepend=frozen_before[None].astype(np.int8)) > 0)
    lost = np.zeros(len(frame), EVENT_DTYPE)
    lost["frame"], lost["agent"], lost["kind"] = frame + first, agent, EVENT_NAMES.index("nonfinite")
    return np.concatenate([own, lost, np.array(seen.events, EVENT_DTYPE)])


def colors(count: int) -> np.ndarray:
    """A colour for each individual that its neighbours in the list do not have: linear RGB, shape [count, 3]."""
    # Hues a golden section apart fill the circle evenly however many there are.
    hues = (np.arange(count) * GOLDEN_RATIO + 0.03) % 1.0
    values = 0.95 - 0.12 * (np.arange(count) % 3)
    return np.array([colorsys.hsv_to_rgb(h, 0.72, v) for h, v in zip(hues, values, strict=True)])
