"""A simulation on its way into a recording.

Frames stream out in chunks with the full state at the start of each, so that a run which is killed goes on to the same
bytes. Where a person rides, what they did is recorded too, frame by frame: given that, the run comes out the same
without them.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.errors import InputError
from echelon.ranks import Ranks
from echelon.recording import EVENT_DTYPE, EVENT_NAMES, Cast, Recording, RecordingWriter
from echelon.scenario import Scenario
from echelon.simulation.cost import RunCost
from echelon.simulation.loop import Simulation
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine

Progress = Callable[[int, int], None]
"""Called with (frames done, frames at most)."""

GOLDEN_RATIO = 0.6180339887498949


class RecordedRun:
    """A simulation that is recorded, a frame at a time; what has been simulated is written meanwhile.

    Attributes:
        simulation: What runs.
        writer: Of the recording.
    """

    def __init__(self, simulation: Simulation, writer: RecordingWriter) -> None:
        """
        Args:
            simulation: At the frame that the writer comes to next.
            writer: Of a recording of it, opened with `recording_of` or again.
        """
        self.simulation = simulation
        self.writer = writer
        self._length = min(writer.chunk_frames, writer.frame_limit)
        self._chunks = simulation.bind(self._length)
        self._own_count = sum(engine.agent_count for engine in simulation.engines)
        self._begin_chunk()

    def _begin_chunk(self) -> None:
        """Room for the next chunk; it begins on disk with its first frame."""
        self._count = self._given = 0

    @property
    def over(self) -> bool:
        """Whether the run has come to its end, or what the scenario runs until has come about."""
        return self.simulation.frame >= self.writer.frame_limit or self.simulation.finished

    @property
    def link_poses(self) -> np.ndarray:
        """Of the frame simulated last, in the world, float64, shape [agents, links, 7]; `advance` has been called."""
        last = slice(self._last, self._last + 1)
        poses = _rows(self._chunks, "poses", last)[0].astype(np.float64)
        poses[..., :3] += _rows(self._chunks, "origins", last)[0][:, None, :]
        return poses

    @property
    def phases(self) -> np.ndarray:
        """Of the frame simulated last, int8, shape [agents]."""
        return _rows(self._chunks, "phases", slice(self._last, self._last + 1))[0]

    @property
    def actor_poses(self) -> np.ndarray:
        """Of the frame simulated last, in the world, float64, shape [actors, 7]."""
        return self._seen.actor_poses[self._last]

    @property
    def fallen(self) -> np.ndarray:
        """Who has fallen in the frame simulated last, bool, shape [agents]."""
        return _rows(self._chunks, "fallen", slice(self._last, self._last + 1))[0].view(np.bool_)

    def advance(self, controls: np.ndarray | None = None) -> None:
        """Simulate a frame and hand it over.

        Args:
            controls: What the person does from this frame to the next, float32, shape [controls]; None where nobody
                rides.

        Raises:
            RecordingFailed: Writing failed; what counts is safe.
        """
        simulation, writer, clock = self.simulation, self.writer, self.simulation.clock
        if self._count == 0:
            clock.start()
            self._first, self._frozen = simulation.frame, [engine.frozen for engine in simulation.engines]
            writer.begin_chunk(simulation.shared_state(), simulation.agent_state())
            self._seen = SceneFrames.allocate(self._length, simulation.scene, self._own_count)
            clock.lap("record")
        if controls is not None:
            simulation.scene.ride(controls)
            self._seen.controls[self._count] = controls
        simulation.advance(self._count, self._seen)
        self._last = self._count
        self._count += 1
        ends = self._count == self._length or self.over
        if self._count - self._given == writer.piece_frames or ends:
            self._hand_over()
        if ends:
            self._end_chunk()

    def finish(self) -> None:
        """End the run here, and mark the recording as done.

        Raises:
            RecordingFailed: Writing failed.
        """
        if self._count:
            if self._given < self._count:
                self._hand_over()
            self._end_chunk()
        self.writer.finish(self.simulation.summary())
        self.simulation.clock.seconds["write"] = self.writer.seconds

    def _hand_over(self) -> None:
        clock = self.simulation.clock
        clock.start()
        part = slice(self._given, self._count)
        self.writer.extend(_frames(self._chunks, self._seen, part, self.simulation.character))
        clock.lap("record")
        self._given = self._count

    def _end_chunk(self) -> None:
        simulation, count = self.simulation, self._count
        simulation.clock.start()
        found = [
            _events(chunk, engine, self._first, count, before)
            for chunk, engine, before in zip(self._chunks, simulation.engines, self._frozen, strict=True)
        ]
        events = np.concatenate([*found, np.array(self._seen.events, EVENT_DTYPE)])
        kinds = np.bincount(events["kind"], minlength=len(EVENT_NAMES))
        for kind, number in enumerate(simulation.ranks.sum(kinds)):
            simulation.counts[EVENT_NAMES[kind]] += int(number)
        measures = _measures(self._chunks, self._seen, slice(count), simulation.character)
        simulation.measure_sums += measures.sum(axis=0, dtype=np.float64)
        self.writer.end_chunk(events)
        simulation.clock.lap("record")
        self._begin_chunk()


def recording_of(simulation: Simulation, recording: str | Path, ranks: Ranks | None = None) -> RecordingWriter:
    """Begin the recording of a simulation; one that is there is replaced.

    Raises:
        InputError: The folder cannot be written, or is something else.
    """
    scenario = simulation.scenario
    return RecordingWriter.create(
        recording,
        scenario=scenario.to_dict(),
        frame_rate=scenario.frame_rate,
        frame_limit=scenario.step_count + 1,
        casts=recorded_casts(simulation),
        world=simulation.scene.world,
        actors=simulation.scene.actors,
        phase_names=simulation.fallen.phase_names,
        measure_names=simulation.measure_names,
        control_names=simulation.scene.control_names,
        ranks=ranks,
    )


def simulate(
    scenario: Scenario,
    *,
    recording: str | Path,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    ranks: Ranks | None = None,
    cost: RunCost | None = None,
    controls: np.ndarray | None = None,
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
        controls: What a person on the user's bicycle did, as a recording of that has it; the run ends with them.

    Returns:
        The recording.

    Raises:
        InputError: The folder cannot be written, or is something else, or the scenario is for a person to ride in and
            nobody does.
        RecordingFailed: Writing failed on the way; what was written can be resumed.
    """
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device, ranks=ranks)
        stack.callback(simulation.close)
        if simulation.scene.control_names and controls is None:
            raise InputError(f"{scenario.name}: is for a person to ride in; start it with echelon play")
        writer = stack.enter_context(recording_of(simulation, recording, ranks))
        simulation.preroll()
        _run(simulation, writer, progress, controls)
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

    One in which a person rode ends where they were interrupted.

    Args:
        recording: Its folder.
        threads, progress, device, ranks, cost: As for `simulate`.

    Raises:
        InputError: It is no recording, or is finished.
        RecordingFailed: Writing failed, or this program or machine computes something else than the first did.
    """
    begun = Recording(recording)
    scenario = Scenario.from_dict(begun.scenario, source=str(recording))
    controls = begun.controls[:] if begun.control_names else None
    if controls is not None and len(controls) == 0 and begun.status == "running":
        raise InputError(f"{recording}: whoever rode was interrupted before anything was kept; nothing to resume")
    with ExitStack() as stack:
        simulation = Simulation(scenario, threads=threads, device=device, world=begun.world, ranks=ranks)
        stack.callback(simulation.close)
        writer, state = RecordingWriter.reopen(recording, ranks)
        stack.enter_context(writer)
        if state is None:
            simulation.preroll()
        else:
            simulation.load_state(state, writer.next_frame)
        _run(simulation, writer, progress, controls)
        if cost is not None:
            cost.fill_in(simulation.clock, max(e.team.size for e in simulation.engines), simulation.ranks)
    return Recording(recording)


def _run(
    simulation: Simulation, writer: RecordingWriter, progress: Progress | None, controls: np.ndarray | None
) -> None:
    """From the present frame to the end."""
    total = writer.frame_limit if controls is None else len(controls)
    run = RecordedRun(simulation, writer)
    while not run.over and simulation.frame < total:
        run.advance(None if controls is None else controls[simulation.frame])
        if progress is not None:
            progress(simulation.frame, total)
    run.finish()


def recorded_casts(simulation: Simulation) -> list[Cast]:
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
    frames["controls"] = seen.controls[part]
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
