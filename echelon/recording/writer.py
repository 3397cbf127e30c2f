"""Writing a recording, a chunk at a time, so that a run killed at any moment can be gone on with.

The frame loop hands over a chunk and simulates the next while this one is written by a thread::

    with RecordingWriter.create(path, ...) as writer:
        buffers = writer.buffers(), writer.buffers()          # filled in turn
        while not finished:
            state = ...                                       # before the chunk's first frame is advanced
            frames = ...                                      # rows of buffers[turn]
            writer.append(frames, state, events)
        writer.finish(summary)

To go on with a recording, ``reopen`` it: it gives the state at the first frame of the last whole chunk. That chunk is
simulated again, and what comes out is compared with what is there before anything is added: a program, or a machine,
that would go on differently is found out.

Where several ranks simulate, each has a writer, hands over its own agents, and writes shards of the crowd (`shards`).
The first rank writes what is not of single agents, and the manifest, which counts a chunk once all have written it:
they tell each other how many they have `written` once a frame, with what else they tell each other then.
"""

from __future__ import annotations

import base64
import errno
import json
import os
import time
import types
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.ranks import Ranks
from echelon.recording.layout import (
    EVENT_DTYPE,
    MANIFEST,
    ArrayLayout,
    StatePart,
    agent_state_array,
    checksum,
    chunk_frames,
    event_array,
    event_rows,
    pack_agent_state,
    pack_state,
    read_chunk,
    replace_file,
    shard_agents,
    state_array,
    state_parts,
    unpack_state,
)
from echelon.recording.manifest import (
    EVENT_NAMES,
    FORMAT,
    PHASE_NAMES,
    VERSION,
    Actor,
    ActorEntry,
    Cast,
    CastEntry,
    Manifest,
    RecordingFailed,
    check_chunks,
    manifest_frame_arrays,
    manifest_text,
    read_manifest,
)
from echelon.recording.place import lock, make_folder
from echelon.recording.shards import Pieces, Shards


class RecordingWriter:
    """A recording that is being written. Made by `create` or `reopen`; a context manager.

    Attributes:
        path: Folder of the recording.
        manifest: What the recording is; its counts are those of the moment it was opened.
        chunk_frames: Frames in each chunk but the last.
        frame_limit: The most frames that the run can have, the start pose included.
        next_frame: First frame of the next chunk to append.
        written: Chunks of which this rank has written its part.
        seconds: Time that writing has taken so far, in a thread of its own [s].
    """

    def __init__(self, path: Path, manifest: Manifest, held: int | None, ranks: Ranks) -> None:
        self.path = path
        self.manifest = manifest
        self.chunk_frames = manifest.chunk_frames
        self.frame_limit = manifest.frame_limit
        self.next_frame = max(manifest.chunk_count - 1, 0) * manifest.chunk_frames
        self._constant = manifest.constant_text()
        self._arrays = manifest_frame_arrays(manifest)
        self._events = event_array(manifest.event_rows)
        self._state_parts: tuple[StatePart, ...] = manifest.state
        self._described: dict[str, int] = {}  # length of each array as its zarr.json has it, where that is known
        self._ranks = ranks
        self._shards = Shards(ranks, manifest.agent_count, manifest.shard_agents)
        self._committed = manifest.chunk_count
        self.written = self.next_frame // manifest.chunk_frames
        self.seconds = 0.0
        self._uncounted: dict[int, tuple[int, int]] = {}  # frames and events up to the end of a chunk, by its index
        self._event_count = 0
        self._event_tail = np.zeros((0, 4), np.int32)
        self._lock = held
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._writing: Future[None] | None = None
        self._counting: Future[None] | None = None
        self._ended = False

    # ---- opening ---------------------------------------------------------------------------------------------------
    @classmethod
    def create(
        cls,
        path: str | Path,
        *,
        scenario: Mapping[str, Any],
        frame_rate: int,
        frame_limit: int,
        casts: Sequence[Cast],
        world: Mapping[str, Any],
        actors: Sequence[Actor] = (),
        phase_names: Sequence[str] = PHASE_NAMES,
        measure_names: Sequence[str] = (),
        event_names: Sequence[str] = EVENT_NAMES,
        length: int | None = None,
        ranks: Ranks | None = None,
    ) -> RecordingWriter:
        """Begin a recording at ``path``; one that is there already is replaced.

        Args:
            path: Folder to make. Its parent must exist.
            scenario: The resolved scenario, plain data.
            frame_rate: Frames a second.
            frame_limit: The most frames that the run can have, the start pose included.
            casts: Who is in it, by first agent.
            world: Set pieces, plain data.
            actors: Who else is in the picture.
            phase_names, event_names: What the numbers of phases and kinds of event mean.
            measure_names: What is measured of each agent in each frame.
            length: Frames in a chunk; by default up to twenty seconds, fewer for a very large crowd.
            ranks: Who write it together, all with the same arguments; None for this process alone.

        Raises:
            InputError: There is something at ``path`` that is not a recording, or it cannot be written, or another
                process is writing it.
        """
        path = Path(path)
        ranks = ranks or Ranks()
        agent_count = sum(cast.agent_count for cast in casts)
        link_count = max(len(cast.body.links) for cast in casts)
        manifest = Manifest(
            format=FORMAT,
            version=VERSION,
            status="running",
            frame_rate=frame_rate,
            frame_limit=frame_limit,
            chunk_frames=length
            or chunk_frames(frame_rate, frame_limit, agent_count, link_count, len(actors), len(measure_names)),
            frame_count=0,
            chunk_count=0,
            event_count=0,
            event_rows=event_rows(agent_count),
            agent_count=agent_count,
            shard_agents=shard_agents(agent_count),
            link_count=link_count,
            phase_names=tuple(phase_names),
            measure_names=tuple(measure_names),
            event_names=tuple(event_names),
            actors=tuple(ActorEntry(actor.name, actor.kind) for actor in actors),
            casts=tuple(_cast_entry(cast) for cast in casts),
            scenario=dict(scenario),
            world=dict(world),
        )
        with ranks.first_before_others():
            held = make_folder(path, manifest) if ranks.is_first else None
        writer = cls(path, manifest, held, ranks)
        writer._described = {name: frame_limit for name in writer._arrays}
        return writer

    @classmethod
    def reopen(
        cls, path: str | Path, ranks: Ranks | None = None
    ) -> tuple[RecordingWriter, dict[str, np.ndarray] | None]:
        """Go on with a recording that was interrupted.

        Args:
            path: Its folder.
            ranks: Who go on with it together, not necessarily as many as before; None for this process alone.

        Returns:
            The writer, whose ``next_frame`` is where to go on, and the full state there; None instead of a state
            where not one chunk was written, so that the run begins anew at frame 0.

        Raises:
            InputError: It is not a recording, is damaged, is of an unknown version, is finished, or is being written
                by another process.
        """
        path = Path(path)
        ranks = ranks or Ranks()
        manifest = read_manifest(path)
        if manifest.status == "done":
            raise InputError(f"{path}: this recording is finished ({manifest.frame_count} frames); nothing to resume")
        check_chunks(path, manifest)
        writer = cls(path, manifest, lock(path) if ranks.is_first else None, ranks)
        try:
            with ranks.first_before_others():
                if ranks.is_first:
                    writer._remove_uncommitted()
            return writer, writer._restore()
        except OSError as error:
            writer.close()
            raise InputError(f"{path}: cannot be resumed ({error.strerror})") from None
        except InputError:
            writer.close()
            raise

    def buffers(self) -> dict[str, np.ndarray]:
        """Arrays for one chunk, by name, of the types and shapes that `append` takes; all zeros."""
        return {
            name: np.zeros((self.chunk_frames, *self._own_row(layout)), layout.dtype)
            for name, layout in self._arrays.items()
        }

    # ---- writing ---------------------------------------------------------------------------------------------------
    def append(
        self,
        frames: Mapping[str, np.ndarray],
        state: Mapping[str, np.ndarray],
        events: np.ndarray | None = None,
        agent_state: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Hand over the next chunk; returns as soon as the chunk before it is on disk. All ranks call it at once.

        The arrays belong to the writer until the next ``append``, ``finish`` or ``close`` has returned.

        Args:
            frames: For each array of `buffers` the chunk's frames, shape [frames, ...]: ``chunk_frames`` of them, or
                fewer in the last chunk of the run. Of agents, this rank's.
            state: The simulation state at the chunk's first frame, by name; the same names and shapes each time.
                The same on all ranks.
            events: What happened in these frames, `EVENT_DTYPE`, in any order; on each rank, to its own agents.
            agent_state: What there is of the state that has a row for each agent; of this rank's agents.

        Raises:
            RecordingFailed: A chunk could not be written, or differs from the one that was there before.
            ValueError: What was handed over does not have the shape that was agreed.
        """
        if self._ended:
            raise ValueError("the last chunk of this recording has been appended")
        count = len(frames["link_poses"])
        if not 0 < count <= self.chunk_frames or self.next_frame + count > self.frame_limit:
            raise ValueError(f"{count} frames do not fit: {self.chunk_frames} a chunk, {self.frame_limit} in all")
        rows = {name: self._checked(layout, frames, count) for name, layout in self._arrays.items()}
        table = _event_table(events, self.next_frame, self.next_frame + count)
        agents = agent_state or {}
        parts = state_parts(state, agents, self.manifest.agent_count)
        if not self._state_parts:
            self._state_parts = parts
        elif parts != self._state_parts:
            raise ValueError("the state does not have the names, types and shapes of the chunk before")
        self._wait()
        index = self.next_frame // self.chunk_frames
        self.next_frame += count
        self._ended = count < self.chunk_frames
        self._writing = self._thread.submit(
            self._write, index, self._rows_to_write(rows, agents), dict(state), self._gathered(table), self.next_frame
        )

    def count_written(self, written: int) -> None:
        """Have the manifest count what all ranks have written; only the first rank's does.

        Args:
            written: How many chunks each rank has `written`, at the least.
        """
        if self._ranks.size == 1 or not self._ranks.is_first or not self._uncounted:
            return
        whole = [index for index in self._uncounted if index < written]
        if whole:
            counts = self._uncounted[max(whole)]
            for index in whole:
                del self._uncounted[index]
            self._counting = self._thread.submit(self._commit, *counts)

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Wait for the last chunk and mark the recording as done.

        Args:
            summary: What the run reports, plain data; nothing in it may come from a clock.

        Raises:
            RecordingFailed: It could not be written.
        """
        self._wait()
        self._ranks.barrier()
        if self.next_frame < self.manifest.frame_count:
            raise ValueError(f"{self.next_frame} frames cannot replace the {self.manifest.frame_count} that there are")
        if self._ranks.is_first:
            try:
                for layout in self._arrays.values():
                    self._describe(layout, self.next_frame)
                self._describe_states(-(-self.next_frame // self.chunk_frames))
                self._describe(self._events, self._event_count)
                self._commit(self.next_frame, self._event_count, status="done", summary=summary)
            except OSError as error:
                raise self._failed(error) from None
        self.close()
        self._ranks.barrier()

    def close(self) -> None:
        """Wait for the chunk that is being written, and let go of the folder; unfinished, it can be resumed."""
        self._ended = True
        try:
            self._wait()
        finally:
            self._thread.shutdown()
            if self._lock is not None:
                os.close(self._lock)
                self._lock = None

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: types.TracebackType | None
    ) -> None:
        self.close()

    # ---- from rank to rank -----------------------------------------------------------------------------------------
    def _rows_to_write(
        self, frames: Mapping[str, np.ndarray], agent_state: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray | Pieces]:
        """What this rank writes of the frames, and of the states of agents: arrays of agents as pieces of shards."""
        agents = {
            name: np.asarray(array, self._arrays[name].dtype)
            for name, array in frames.items()
            if self._arrays[name].agents and self._arrays[name].nbytes
        }
        if self._agent_states.nbytes:
            agents[self._agent_states.name] = pack_agent_state(self._state_parts, agent_state, self._shards.count)
        others = {name: array for name, array in frames.items() if not self._arrays[name].agents}
        return {**(others if self._ranks.is_first else {}), **self._shards.collect(agents)}

    def _gathered(self, table: np.ndarray) -> np.ndarray:
        """The events of all ranks, sorted, on the first."""
        if self._ranks.size == 1:
            return table
        return _sorted(self._ranks.gather(table))

    @property
    def _agent_states(self) -> ArrayLayout:
        return agent_state_array(self._state_parts, self.manifest.agent_count, self.manifest.shard_agents)

    # ---- in the thread ---------------------------------------------------------------------------------------------
    def _write(
        self,
        index: int,
        rows: dict[str, np.ndarray | Pieces],
        state: dict[str, np.ndarray],
        table: np.ndarray,
        frame_end: int,
    ) -> None:
        """Write and commit one chunk, or compare it where it has been committed before."""
        begun = time.perf_counter()
        layouts = {layout.name: layout for layout in (*self._arrays.values(), self._agent_states)}
        write = self._compare if index < self._committed else self._store
        try:
            if index == 0:
                (self.path / self._agent_states.name).mkdir(exist_ok=True)
                if self._ranks.is_first:
                    self._describe_states(-(-self.frame_limit // self.chunk_frames))
            for name, array in rows.items():
                if isinstance(array, np.ndarray):
                    write(layouts[name], index, 0, array)
                else:
                    for shard in self._shards.owned:
                        write(layouts[name], index, shard, self._shards.rows(array, shard))
            if self._ranks.is_first:
                write(state_array(self._state_parts), index, 0, pack_state(self._state_parts, state))
                if index < self._committed:
                    self._compare_events(table)
                else:
                    self._store_events(table)
                    self._uncounted[index] = (frame_end, self._event_count)
                    if self._ranks.size == 1:
                        self._commit(*self._uncounted.pop(index))
        except OSError as error:
            raise self._failed(error) from None
        self.written = index + 1
        self.seconds += time.perf_counter() - begun

    def _store(self, layout: ArrayLayout, index: int, shard: int, array: np.ndarray) -> None:
        if layout.nbytes:
            data = _chunk_bytes(layout, array)
            name = self.path / layout.name / layout.chunk_name(index, shard)
            replace_file(name, data, checksum(data, layout.nbytes), layout.nbytes)

    def _compare(self, layout: ArrayLayout, index: int, shard: int, array: np.ndarray) -> None:
        if layout.nbytes:
            with open(self.path / layout.name / layout.chunk_name(index, shard), "rb") as stored:
                stored.seek(layout.nbytes)
                if stored.read() != checksum(_chunk_bytes(layout, array), layout.nbytes):
                    raise self._different(layout)

    def _compare_events(self, table: np.ndarray) -> None:
        size = self._events.chunk[0]
        first = self._event_count // size
        rows = np.concatenate([self._event_tail, table])
        same = self._event_count + len(table) == self.manifest.event_count
        for start in range(0, len(rows) if same else 0, size):
            part = rows[start : start + size]
            same = same and np.array_equal(
                read_chunk(self.path, self._events, first + start // size)[: len(part)], part
            )
        if not same:
            raise self._different(self._events)
        self._count_events(table)

    def _count_events(self, table: np.ndarray) -> None:
        """Add events to those known, keeping the rows of the chunk of events that is not yet full."""
        rows = np.concatenate([self._event_tail, table])
        self._event_count += len(table)
        full = len(rows) // self._events.chunk[0] * self._events.chunk[0]
        self._event_tail = rows[full:]

    def _store_events(self, table: np.ndarray) -> None:
        size = self._events.chunk[0]
        before = -(-self._event_count // size)
        first = self._event_count // size
        rows = np.concatenate([self._event_tail, table])
        if len(table):
            for start in range(0, len(rows), size):
                self._store(self._events, first + start // size, 0, rows[start : start + size])
        self._count_events(table)
        chunks = -(-self._event_count // size)
        if chunks != before:
            self._describe(self._events, chunks * size)

    def _describe(self, layout: ArrayLayout, length: int) -> None:
        if self._described.get(layout.name) != length:
            folder = self.path / layout.name
            folder.mkdir(exist_ok=True)
            replace_file(folder / "zarr.json", json.dumps(layout.metadata(length)).encode())
            self._described[layout.name] = length

    def _describe_states(self, length: int) -> None:
        self._describe(state_array(self._state_parts), length)
        if self._agent_states.nbytes:
            self._describe(self._agent_states, length)

    def _commit(
        self,
        frame_count: int,
        event_count: int,
        status: str = "running",
        summary: Mapping[str, Any] | None = None,
    ) -> None:
        text = manifest_text(
            self._constant,
            status=status,
            frame_count=frame_count,
            chunk_count=-(-frame_count // self.chunk_frames),
            event_count=event_count,
            state=self._state_parts,
            summary=summary,
        )
        replace_file(self.path / MANIFEST, text.encode())

    # ---- going on --------------------------------------------------------------------------------------------------
    def _remove_uncommitted(self) -> None:
        """Leave only what the manifest counts, described as it is while a run goes on."""
        manifest = self.manifest
        layouts = [*self._arrays.values(), state_array(self._state_parts), self._agent_states]
        keep = {
            layout.name: {
                layout.chunk_name(index, shard)
                for index in range(manifest.chunk_count)
                for shard in range(layout.shards)
            }
            for layout in layouts
        }
        event_chunks = -(-manifest.event_count // manifest.event_rows)
        keep["events"] = {self._events.chunk_name(i) for i in range(event_chunks)}
        for entry in list(self.path.iterdir()):
            if entry.name in keep and entry.is_dir():
                for file in list(entry.iterdir()):
                    if file.name not in keep[entry.name] and file.name != "zarr.json":
                        file.unlink()
            elif entry.name.endswith(".part"):
                entry.unlink()
        for layout in self._arrays.values():
            self._describe(layout, manifest.frame_limit)
        self._describe(self._events, event_chunks * manifest.event_rows)
        if self._committed:
            self._describe_states(-(-self.frame_limit // self.chunk_frames))

    def _restore(self) -> dict[str, np.ndarray] | None:
        """The state to go on from; takes up the events before it."""
        if not self._committed:
            return None
        size, count = self._events.chunk[0], self.manifest.event_count
        tail = np.zeros((0, 4), np.int32)
        for index in range(-(-count // size) - 1, -1, -1):
            rows = read_chunk(self.path, self._events, index)[: count - index * size]
            before = int(np.searchsorted(rows[:, 0], self.next_frame))
            if before or index == 0:
                tail, self._event_count = rows[:before], index * size + before
                break
        # A full chunk of events is complete: what comes next opens another.
        self._event_tail = tail[len(tail) // size * size :].astype(np.int32)
        packed, agents = (
            read_chunk(self.path, layout, self._committed - 1)[0]
            for layout in (state_array(self._state_parts), self._agent_states)
        )
        return unpack_state(self._state_parts, packed, agents)

    # ---- checks ----------------------------------------------------------------------------------------------------
    def _checked(self, layout: ArrayLayout, frames: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        array = frames[layout.name]
        row = self._own_row(layout)
        if array.shape != (count, *row) or not np.can_cast(array.dtype, layout.dtype, "same_kind"):
            raise ValueError(
                f"{layout.name}: {array.dtype} {list(array.shape)} is not {np.dtype(layout.dtype).name} {[count, *row]}"
            )
        return array

    def _own_row(self, layout: ArrayLayout) -> tuple[int, ...]:
        """Shape of a row of an array as this rank has it: of its own agents."""
        return (self._shards.count, *layout.row[1:]) if layout.agents else layout.row

    def _wait(self) -> None:
        """Wait for the chunk that is being written, and raise what went wrong with it."""
        waiting, self._writing, self._counting = (self._writing, self._counting), None, None
        for job in waiting:
            if job is not None:
                try:
                    job.result()
                except OSError as error:
                    self._ended = True
                    raise self._failed(error) from None
                except Exception:
                    self._ended = True
                    raise

    def _failed(self, error: OSError) -> RecordingFailed:
        hint = "; free some space" if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", None)) else ""
        return RecordingFailed(
            f"{self.path}: cannot be written ({error.strerror or error}){hint}; what was recorded before is safe, and "
            "the run can be resumed"
        )

    def _different(self, layout: ArrayLayout) -> RecordingFailed:
        return RecordingFailed(
            f"{self.path}: {layout.name} came out differently than when this was recorded; it can be resumed only by "
            "the version of Echelon, on the kind of processor, that began it"
        )


# ---- plain data ---------------------------------------------------------------------------------------------------
def _cast_entry(cast: Cast) -> CastEntry:
    colors = base64.b64encode(np.ascontiguousarray(cast.colors, dtype="<f8").tobytes()).decode("ascii")
    return CastEntry(cast.name, cast.body.to_dict(), cast.first_agent, cast.agent_count, colors)


# ---- chunks --------------------------------------------------------------------------------------------------------
def _chunk_bytes(layout: ArrayLayout, array: np.ndarray) -> np.ndarray:
    """Numbers as they stand in the file of a chunk, which has room for as many agents as any; uint8, shape [bytes]."""
    if layout.agents and array.shape[1] < layout.chunk[1]:
        room = np.zeros((len(array), layout.chunk[1] - array.shape[1], *array.shape[2:]), array.dtype)
        array = np.concatenate([array, room], axis=1)
    return np.ascontiguousarray(array, dtype=layout.dtype).reshape(-1).view(np.uint8)


def _event_table(events: np.ndarray | None, first: int, end: int) -> np.ndarray:
    """Events as rows of frame, substep, agent, kind, sorted, int32, shape [events, 4]."""
    if events is None or not len(events):
        return np.zeros((0, 4), np.int32)
    if events.dtype != EVENT_DTYPE:
        raise ValueError(f"events: {events.dtype} is not {EVENT_DTYPE}")
    if events["frame"].min() < first or events["frame"].max() >= end:
        raise ValueError(f"events: of frames outside of this chunk, {first} to {end - 1}")
    return _sorted(np.stack([events[name].astype(np.int32) for name in EVENT_DTYPE.names or ()], axis=1))


def _sorted(table: np.ndarray) -> np.ndarray:
    """Rows of events by frame, substep, agent, kind."""
    return table[np.lexsort(table.T[::-1])]
