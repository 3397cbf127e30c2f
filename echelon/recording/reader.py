"""A recording that is read back: lazily, a chunk at a time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.recording.layout import (
    EVENT_DTYPE,
    ArrayLayout,
    agent_state_array,
    event_array,
    read_chunk,
    state_array,
    unpack_state,
)
from echelon.recording.manifest import (
    REMOVED_PHASE,
    Actor,
    Cast,
    Manifest,
    check_chunks,
    manifest_frame_arrays,
    read_manifest,
)
from echelon.warp_kernels.model import Model


class LazyFrames:
    """An array with one row a frame, of which only what is asked for is read.

    It is indexed like a NumPy array, gives NumPy arrays, and keeps the chunk that was read last, so that walking
    through the frames reads each chunk once. ``np.asarray`` reads all of it.

    Attributes:
        shape: [frames, ...].
        dtype: Of what it gives.
    """

    def __init__(self, path: Path, layout: ArrayLayout, length: int) -> None:
        self.shape: tuple[int, ...] = (length, *layout.row)
        self.dtype = np.dtype(layout.dtype)
        self._path = path
        self._layout = layout
        self._chunk_length = layout.chunk[0]
        self._kept: tuple[int, np.ndarray] | None = None

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise ValueError("an array that is read from disk is always a copy")
        return np.asarray(self[:], dtype=dtype)

    def __getitem__(self, key: Any) -> np.ndarray:
        """NumPy's indexing: integers, slices, an ellipsis, arrays of indices or of booleans.

        Raises:
            InputError: The recording is damaged where it was read.
            IndexError: As NumPy's.
        """
        first, rest = self._split(key)
        if isinstance(first, slice):
            frames = np.arange(*first.indices(len(self)))
            if all(isinstance(part, int | np.integer | slice) for part in rest):
                return self._gather(frames, rest)
            return self._gather(frames)[(slice(None), *rest)]
        if isinstance(first, int | np.integer):
            frame = int(first) + (len(self) if first < 0 else 0)
            if not 0 <= frame < len(self):
                raise IndexError(f"frame {int(first)} is out of bounds for {len(self)} frames")
            return self._gather(np.array([frame]))[(0, *rest)]
        wanted = np.asarray(first)
        indices = np.arange(len(self))[wanted if wanted.size else wanted.astype(np.int64)]
        frames, places = np.unique(indices, return_inverse=True)
        return self._gather(frames)[(places.reshape(indices.shape), *rest)]

    def _split(self, key: Any) -> tuple[Any, tuple[Any, ...]]:
        """The index of the frames, and those of the other dimensions."""
        parts = key if isinstance(key, tuple) else (key,)
        if any(
            part is None or (isinstance(part, np.ndarray) and part.dtype == bool and part.ndim > 1) for part in parts
        ):
            raise IndexError("new axes and masks of several dimensions are not read lazily; use np.asarray first")
        dots = [index for index, part in enumerate(parts) if part is Ellipsis]
        if len(dots) > 1 or len(parts) - len(dots) > self.ndim:
            raise IndexError(f"too many indices for {self.ndim} dimensions")
        if dots:
            fill = (slice(None),) * (self.ndim - len(parts) + 1)
            parts = (*parts[: dots[0]], *fill, *parts[dots[0] + 1 :])
        return (parts[0], tuple(parts[1:])) if parts else (slice(None), ())

    def _gather(self, frames: np.ndarray, rest: tuple[Any, ...] = ()) -> np.ndarray:
        """Rows of these frames, in their order, each indexed with ``rest`` (integers and slices); always a copy."""
        if not len(frames):
            return np.zeros((1, *self.shape[1:]), self.dtype)[(slice(0, 0), *rest)]
        blocks = []
        for part in np.split(frames, np.flatnonzero(np.diff(frames // self._chunk_length)) + 1):
            chunk = self._chunk(int(part[0]) // self._chunk_length)
            rows = part % self._chunk_length
            run = np.all(np.diff(rows) == 1)  # a slice is read without copying the rows once more
            blocks.append(chunk[(slice(int(rows[0]), int(rows[-1]) + 1) if run else rows, *rest)])
        return np.concatenate(blocks)

    def _chunk(self, index: int) -> np.ndarray:
        if self._kept is None or self._kept[0] != index:
            self._kept = None  # so that there are never two
            self._kept = (index, self._read(index))
        return self._kept[1]

    def _read(self, index: int) -> np.ndarray:
        """All rows of one chunk, those past the end included."""
        return read_chunk(self._path, self._layout, index)


class LazyPhase(LazyFrames):
    """Whether agents are in one phase, bool; never where the run has no such phase."""

    def __init__(self, path: Path, phases: ArrayLayout, length: int, phase_names: Sequence[str], name: str) -> None:
        super().__init__(path, phases, length)
        self.dtype = np.dtype(bool)
        self._phase = phase_names.index(name) if name in phase_names else None

    def _read(self, index: int) -> np.ndarray:
        if self._phase is None:
            return np.zeros((self._chunk_length, *self.shape[1:]), bool)
        return super()._read(index) == self._phase


class LazyPoses(LazyFrames):
    """Poses of links in the world, float64: what is stored near a floating origin, with the origin added."""

    def __init__(self, path: Path, poses: ArrayLayout, origins: ArrayLayout, length: int) -> None:
        super().__init__(path, poses, length)
        self.dtype = np.dtype(np.float64)
        self._origins = LazyFrames(path, origins, length)

    def _read(self, index: int) -> np.ndarray:
        rows = super()._read(index).astype(np.float64)
        rows[..., :3] += self._origins._read(index)[:, :, None, :]
        return rows


class Recording:
    """A recording on disk; what is large is read when it is asked for.

    Attributes:
        path: Its folder.
        scenario: The resolved scenario, plain data, as `Scenario.from_dict` takes it.
        world: Set pieces, plain data.
        status: "running" until the run came to its end; a run that was interrupted stays so.
        frame_rate: Frames a second.
        frame_count: Frames that there are.
        chunk_frames: Frames in each chunk but the last.
        agent_count: Agents in all casts.
        casts: Who is in it, by first agent.
        actors: Who else is in the picture.
        phase_names, event_names: What the numbers of phases and kinds of event mean.
        measure_names: What the columns of ``measures`` are.
        control_names: What those of ``controls`` are; none where nobody rode.
        summary: What the run reported; empty while it runs.
        link_poses: Of each link in the world, float64, shape [frames, agents, links, 7]. Agents with fewer
            links than the most repeat their last one.
        velocities: Of the root link in the world [m/s], float32,       [frames, agents, 3]
        desired_velocities: [m/s], float32,                             [frames, agents, 2]
        measures: By ``measure_names``, float32,                        [frames, agents, measures]
        phases: Index into ``phase_names``, int8,                       [frames, agents]
        contacts: Whether a foot is loaded, bool,                       [frames, agents]
        fallen: Whether the agent has fallen, bool,                     [frames, agents]
        frozen: Whether its state stopped being finite, bool,           [frames, agents]
        removed: Whether it has been taken away, bool,                  [frames, agents]
        in_corral: How many are in the corral, int32,                   [frames]
        actor_poses: In the world, float64,                             [frames, actors, 7]
        controls: By ``control_names``, what a person did, float32,     [frames, controls]
    """

    def __init__(self, path: str | Path) -> None:
        """Open the recording at ``path``.

        Raises:
            InputError: It is not a recording, is damaged or truncated, or is of an unknown version.
        """
        self.path = Path(path)
        manifest = read_manifest(self.path)
        check_chunks(self.path, manifest)
        self._manifest = manifest
        self.scenario: dict[str, Any] = manifest.scenario
        self.world: dict[str, Any] = manifest.world
        self.status = manifest.status
        self.frame_rate = manifest.frame_rate
        self.frame_count = manifest.frame_count
        self.chunk_frames = manifest.chunk_frames
        self.agent_count = manifest.agent_count
        self.casts = _casts(self.path, manifest)
        self.actors = tuple(Actor(entry.name, entry.kind) for entry in manifest.actors)
        self.phase_names = manifest.phase_names
        self.measure_names = manifest.measure_names
        self.control_names = manifest.control_names
        self.event_names = manifest.event_names
        self.summary: dict[str, Any] = manifest.summary

        layouts = manifest_frame_arrays(manifest)
        lazy = {name: LazyFrames(self.path, layout, self.frame_count) for name, layout in layouts.items()}
        self.link_poses = LazyPoses(self.path, layouts["link_poses"], layouts["origins"], self.frame_count)
        self.velocities = lazy["velocities"]
        self.desired_velocities = lazy["desired_velocities"]
        self.measures = lazy["measures"]
        self.phases = lazy["phases"]
        self.contacts = lazy["contacts"]
        self.fallen = lazy["fallen"]
        self.frozen = lazy["frozen"]
        self.removed = LazyPhase(self.path, layouts["phases"], self.frame_count, self.phase_names, REMOVED_PHASE)
        self.in_corral = lazy["in_corral"]
        self.actor_poses = lazy["actor_poses"]
        self.controls = lazy["controls"]

    def __repr__(self) -> str:
        size = f"{self.agent_count} agents, {self.frame_count} frames"
        return f"<Recording {str(self.path)!r}: {self.scenario.get('name', '?')}, {size}, {self.status}>"

    @cached_property
    def times(self) -> np.ndarray:
        """Time of each frame [s], shape [frames]."""
        return np.arange(self.frame_count) / self.frame_rate

    @cached_property
    def events(self) -> np.ndarray:
        """What happened, `EVENT_DTYPE`, sorted by frame, substep, agent, kind; shape [events].

        Raises:
            InputError: The recording is damaged there.
        """
        count = self._manifest.event_count
        table = LazyFrames(self.path, event_array(self._manifest.event_rows), count)[:]
        events = np.empty(count, EVENT_DTYPE)
        for column, name in enumerate(EVENT_DTYPE.names or ()):
            events[name] = table[:, column]
        return events

    def state(self, chunk: int) -> dict[str, np.ndarray]:
        """The full simulation state at the first frame of a chunk, by name: frame ``chunk * chunk_frames``.

        Raises:
            IndexError: There is no such chunk.
            InputError: The recording is damaged there.
        """
        manifest = self._manifest
        agents = agent_state_array(manifest.state, manifest.agent_count, manifest.shard_agents)
        packed, packed_agents = (
            LazyFrames(self.path, layout, manifest.chunk_count)[chunk]
            for layout in (state_array(manifest.state), agents)
        )
        return unpack_state(manifest.state, packed, packed_agents)


def _casts(path: Path, manifest: Manifest) -> tuple[Cast, ...]:
    try:
        return tuple(
            Cast(
                entry.name,
                Model.from_dict(entry.body),
                entry.first_agent,
                entry.agent_count,
                entry.color_values().copy(),
            )
            for entry in manifest.casts
        )
    except InputError as error:
        raise InputError(f"{path}: damaged recording: {error}") from None
