"""Writing a recording, so that a run killed at any moment can be gone on with and has lost one chunk at the most.

The frame loop hands over a chunk in pieces, which a thread writes while the next frames are simulated::

    with RecordingWriter.create(path, ...) as writer:
        while not finished:
            writer.begin_chunk(state)                         # before the chunk's first frame is advanced
            while ...:
                writer.extend(frames)                         # some more frames of it; returns at once
            writer.end_chunk(events)                          # returns once the chunk is on disk, and counts
        writer.finish(summary)

No frame is simulated before the chunk before it counts: that is the promise. It costs next to nothing, since at the end
of a chunk all but its last piece is on disk (`chunk_files`).

To go on with a recording, ``reopen`` it: it gives the state at the first frame of the last whole chunk. That chunk is
simulated again, and what comes out is compared with what is there before anything is added: a program, or a machine,
that would go on differently is found out.

Where several ranks simulate, each has a writer, hands over its own agents, and writes shards of the crowd (`shards`).
The first rank writes what is not of single agents, and the manifest, which counts a chunk once all have written it.
"""

from __future__ import annotations

import base64
import errno
import json
import os
import time
import types
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.ranks import Ranks
from echelon.recording.chunk_files import ComparedFile, GrowingFile
from echelon.recording.event_log import EventLog, event_table, sorted_events
from echelon.recording.layout import (
    MANIFEST,
    ArrayLayout,
    StatePart,
    agent_state_array,
    checksum,
    chunk_frames,
    event_rows,
    pack_agent_state,
    pack_state,
    piece_frames,
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
        chunk_frames: Frames in each chunk but the last: the most that a run loses which is killed.
        piece_frames: How many frames to hand over at once, so that each is soon on disk.
        frame_limit: The most frames that the run can have, the start pose included.
        next_frame: First frame of the next chunk.
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
        frame_bytes = sum(array.nbytes for array in self._arrays.values()) // manifest.chunk_frames
        self.piece_frames = piece_frames(max(frame_bytes, 1), manifest.chunk_frames)
        self._events = EventLog(manifest.event_rows)
        self._state_parts: tuple[StatePart, ...] = manifest.state
        self._described: dict[str, int] = {}  # length of each array as its zarr.json has it, where that is known
        self._ranks = ranks
        self._shards = Shards(ranks, manifest.agent_count, manifest.shard_agents)
        self._committed = manifest.chunk_count
        self._safe_frames = manifest.frame_count
        self.seconds = 0.0
        self._lock = held
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._writing: deque[Future[None]] = deque()
        self._broken = False  # writing has failed: what is handed over is let go
        self._begun = False  # a chunk
        self._extended = 0  # frames of the present chunk that have been handed over
        self._files: dict[tuple[str, int], GrowingFile | ComparedFile] = {}  # of it, by array and shard
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
        control_names: Sequence[str] = (),
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
            control_names: What a person does in each frame; none where nobody rides.
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
            control_names=tuple(control_names),
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
        """A whole chunk at once; arguments and what is raised as for `begin_chunk`, `extend` and `end_chunk`."""
        end = self.next_frame + len(frames["link_poses"])
        event_table(events, self.next_frame, end)
        self.begin_chunk(state, agent_state)
        self.extend(frames)
        self.end_chunk(events)

    def begin_chunk(self, state: Mapping[str, np.ndarray], agent_state: Mapping[str, np.ndarray] | None = None) -> None:
        """Begin the next chunk.

        Args:
            state: The simulation state at the chunk's first frame, by name; the same names and shapes each time.
                The same on all ranks. The arrays belong to the writer.
            agent_state: What there is of the state that has a row for each agent; of this rank's agents.

        Raises:
            ValueError: The state does not have the shape that was agreed, or the run has come to its end.
        """
        if self._ended:
            raise ValueError("the last chunk of this recording has been appended")
        agents = agent_state or {}
        parts = state_parts(state, agents, self.manifest.agent_count)
        if not self._state_parts:
            self._state_parts = parts
        elif parts != self._state_parts:
            raise ValueError("the state does not have the names, types and shapes of the chunk before")
        self._settle()
        self._submit(self._begin, dict(state), self._agent_state_rows(agents))
        self._begun = True

    def extend(self, frames: Mapping[str, np.ndarray]) -> None:
        """Hand over the next frames of the chunk; returns at once. All ranks call it at once, with as many frames.

        The arrays belong to the writer until `end_chunk` or `close` has returned.

        Args:
            frames: For each array of `buffers` the frames, shape [frames, ...]; of agents, this rank's.

        Raises:
            RecordingFailed: What was handed over before could not be written, or differs from what was there.
            ValueError: No chunk was begun, or the frames do not fit into it or do not have the shape that was agreed.
        """
        count = len(frames["link_poses"])
        room = min(self.chunk_frames, self.frame_limit - self.next_frame) - self._extended
        if not 0 < count <= room:
            raise ValueError(f"{count} frames do not fit: {self.chunk_frames} a chunk, {self.frame_limit} in all")
        rows = {name: self._checked(layout, frames, count) for name, layout in self._arrays.items()}
        if not self._begun:
            raise ValueError("these frames are of no chunk; begin one first")
        self._settle()
        self._submit(self._add, self._rows_to_write(rows))
        self._extended += count

    def end_chunk(self, events: np.ndarray | None = None) -> None:
        """The chunk is whole; returns once it is on disk and counts. All ranks call it at once.

        Args:
            events: What happened in its frames, `EVENT_DTYPE`, in any order; on each rank, to its own agents.

        Raises:
            RecordingFailed: The chunk could not be written, or differs from the one that was there before.
            ValueError: No frame was handed over, or events are not of its frames.
        """
        if not self._extended:
            raise ValueError("there are no frames in this chunk")
        end = self.next_frame + self._extended
        table = self._gathered(event_table(events, self.next_frame, end))
        self._settle(wait=True)
        index = self.next_frame // self.chunk_frames
        try:
            for (name, _), file in self._files.items():
                file.finish()
                if isinstance(file, ComparedFile) and file.differs:
                    raise self._different(name)
            self._files = {}
            self._ranks.barrier()  # the manifest counts what all have written
            if self._ranks.is_first:
                if index < self._committed:
                    self._compare_events(table)
                else:
                    self._store_events(table)
                    self._commit(end, self._events.count)
        except OSError as error:
            self._ended = True
            raise self._failed(error) from None
        self._safe_frames = max(self._safe_frames, end)
        self._ended = self._extended < self.chunk_frames
        self.next_frame, self._extended, self._begun = end, 0, False

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Mark the recording as done, after its last chunk.

        Args:
            summary: What the run reports, plain data; nothing in it may come from a clock.

        Raises:
            RecordingFailed: It could not be written.
        """
        self._settle(wait=True)
        self._ranks.barrier()
        if self.next_frame < self.manifest.frame_count:
            raise ValueError(f"{self.next_frame} frames cannot replace the {self.manifest.frame_count} that there are")
        if self._ranks.is_first:
            try:
                for layout in self._arrays.values():
                    self._describe(layout, self.next_frame)
                self._describe_states(-(-self.next_frame // self.chunk_frames))
                self._describe(self._events.layout, self._events.count)
                self._commit(self.next_frame, self._events.count, status="done", summary=summary)
            except OSError as error:
                raise self._failed(error) from None
        self.close()
        self._ranks.barrier()

    def close(self) -> None:
        """Let go of the folder, and of what there is of a chunk that is not whole; unfinished, it can be resumed."""
        self._ended = True
        try:
            self._settle(wait=True)
        finally:
            self._thread.shutdown()
            for file in self._files.values():
                file.discard()
            self._files = {}
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
    def _rows_to_write(self, frames: Mapping[str, np.ndarray]) -> dict[str, np.ndarray | Pieces]:
        """What this rank writes of some frames: arrays of agents as pieces of shards."""
        agents = {
            name: np.asarray(array, self._arrays[name].dtype)
            for name, array in frames.items()
            if self._arrays[name].agents and self._arrays[name].nbytes
        }
        others = {name: array for name, array in frames.items() if not self._arrays[name].agents}
        return {**(others if self._ranks.is_first else {}), **self._shards.collect(agents)}

    def _agent_state_rows(self, agent_state: Mapping[str, np.ndarray]) -> Pieces:
        """What this rank writes of the states of agents."""
        layout = self._agent_states
        if not layout.nbytes:
            return []
        rows = pack_agent_state(self._state_parts, agent_state, self._shards.count)
        return self._shards.collect({layout.name: rows})[layout.name]

    def _gathered(self, table: np.ndarray) -> np.ndarray:
        """The events of all ranks, sorted, on the first."""
        if self._ranks.size == 1:
            return table
        return sorted_events(self._ranks.gather(table))

    @property
    def _agent_states(self) -> ArrayLayout:
        return agent_state_array(self._state_parts, self.manifest.agent_count, self.manifest.shard_agents)

    # ---- in the thread ---------------------------------------------------------------------------------------------
    def _submit(self, job: Callable[..., None], *arguments: Any) -> None:
        self._writing.append(self._thread.submit(self._do, job, *arguments))

    def _do(self, job: Callable[..., None], *arguments: Any) -> None:
        if self._broken:
            return
        begun = time.perf_counter()
        try:
            job(*arguments)
        except BaseException:
            self._broken = True
            raise
        self.seconds += time.perf_counter() - begun

    def _begin(self, state: dict[str, np.ndarray], agent_states: Pieces) -> None:
        """Write the state at the first frame of a chunk, or compare it where it has been committed before."""
        index = self.next_frame // self.chunk_frames
        write = self._compare if index < self._committed else self._store
        layout = self._agent_states
        if index == 0:
            (self.path / layout.name).mkdir(exist_ok=True)
            if self._ranks.is_first:
                self._describe_states(-(-self.frame_limit // self.chunk_frames))
        for shard in self._shards.owned if layout.nbytes else ():
            write(layout, index, shard, self._shards.rows(agent_states, shard))
        if self._ranks.is_first:
            write(state_array(self._state_parts), index, 0, pack_state(self._state_parts, state))
        kind = ComparedFile if index < self._committed else GrowingFile
        for layout in self._arrays.values():
            own = self._shards.owned if layout.agents else range(1 if self._ranks.is_first else 0)
            for shard in own if layout.nbytes else ():
                place = self.path / layout.name / layout.chunk_name(index, shard)
                self._files[layout.name, shard] = file = kind(place, layout.nbytes)
                file.create()

    def _add(self, rows: Mapping[str, np.ndarray | Pieces]) -> None:
        """Write some frames of the present chunk."""
        for name, array in rows.items():
            layout = self._arrays[name]
            if not layout.nbytes:
                continue
            if isinstance(array, np.ndarray):
                self._files[name, 0].extend(_chunk_bytes(layout, array))
            else:
                for shard in self._shards.owned:
                    self._files[name, shard].extend(_chunk_bytes(layout, self._shards.rows(array, shard)))

    # ---- files -----------------------------------------------------------------------------------------------------
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
                    raise self._different(layout.name)

    def _compare_events(self, table: np.ndarray) -> None:
        if not self._events.stands_in(self.path, table, self.manifest.event_count):
            raise self._different(self._events.layout.name)
        self._events.add(table)

    def _store_events(self, table: np.ndarray) -> None:
        before = self._events.chunks
        for index, rows in self._events.changed_chunks(table):
            self._store(self._events.layout, index, 0, rows)
        self._events.add(table)
        if self._events.chunks != before:
            self._describe(self._events.layout, self._events.chunks * self._events.layout.chunk[0])

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
        keep["events"] = {self._events.layout.chunk_name(i) for i in range(event_chunks)}
        for entry in list(self.path.iterdir()):
            if entry.name in keep and entry.is_dir():
                for file in list(entry.iterdir()):
                    if file.name not in keep[entry.name] and file.name != "zarr.json":
                        file.unlink()
            elif entry.name.endswith(".part"):
                entry.unlink()
        for layout in self._arrays.values():
            self._describe(layout, manifest.frame_limit)
        self._describe(self._events.layout, event_chunks * manifest.event_rows)
        if self._committed:
            self._describe_states(-(-self.frame_limit // self.chunk_frames))

    def _restore(self) -> dict[str, np.ndarray] | None:
        """The state to go on from; takes up the events before it."""
        if not self._committed:
            return None
        self._events.take_up(self.path, self.manifest.event_count, self.next_frame)
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

    def _settle(self, wait: bool = False) -> None:
        """Raise what has gone wrong with what was handed over; ``wait`` until all of it has been written."""
        while self._writing and (wait or self._writing[0].done()):
            try:
                self._writing.popleft().result()
            except OSError as error:
                self._ended = True
                raise self._failed(error) from None
            except Exception:
                self._ended = True
                raise

    def _failed(self, error: OSError) -> RecordingFailed:
        hint = "; free some space" if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", None)) else ""
        return RecordingFailed(
            f"{self.path}: cannot be written ({error.strerror or error}){hint}; its first {self._safe_frames} frames "
            f"are safe (at most a chunk, {self.chunk_frames} frames, is lost), and the run can be resumed"
        )

    def _different(self, name: str) -> RecordingFailed:
        return RecordingFailed(
            f"{self.path}: {name} came out differently than when this was recorded; it can be resumed only by "
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
