"""How a recording lies on disk: arrays, chunks, checkpoints. Shared by its writer and its reader.

::

    herd.recording/            a zarr v3 group, readable by any zarr
      recording.json           the manifest (`manifest`): what is in it, and how much of it counts
      zarr.json
      link_poses/              one zarr array for each name in ``frame_arrays``, chunked along frames, and along agents
        zarr.json              in *shards*: a crowd of up to `SHARD_AGENTS` is one, a larger one several
        c.0.0.0.0  c.1.0.0.0   one file a chunk: raw little-endian numbers, then their CRC-32C (zarr's codec `crc32c`)
      ...
      events/                  [event, 4] int32: frame, substep, agent, kind
      state/                   [chunk, bytes]: the state at the first frame of each chunk, laid out in the manifest
      agent_state/             [chunk, agent, bytes]: what there is of it of each agent, likewise, in shards

Shards are those of the crowd, whoever writes them: where several ranks simulate it (`echelon.ranks`), each writes the
shards whose first agent is its own, and gets the rows in them that are others'. So the files are the same for any
number of ranks, and no rank writes all.

Three properties, and why they hold:

1. *Whatever the manifest counts is whole.* A chunk's files are written beside and renamed, then the manifest is. What
   it does not count yet is nobody's business: a reader does not look, a writer that resumes removes it. The manifest
   counts a chunk before a frame of the next is simulated, so that a run that is killed loses one chunk at the most.
2. *The same run gives the same bytes, however often it was interrupted.* Nothing in the folder comes from a clock, a
   process or a path; every file is a function of the run alone.
3. *Memory is bounded by the chunk*, for the writer and for the reader.

A killed program loses nothing that the manifest counts. A power cut may, as files are handed to the system and not
forced to the disk: forcing them would make the run wait; what is missing is found out when the recording is opened.

Chunks are raw rather than compressed because poses of hopping robots hardly compress, and compressing them costs more
than simulating them. They are written and read without zarr, which takes 0.4 s to import and more for a chunk than the
writing itself; that zarr reads what is written here is tested.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import google_crc32c
import numpy as np

from echelon.errors import InputError
from echelon.settings import SettingError, Within, adopt

MANIFEST = "recording.json"
CHECKSUM_BYTES = 4
EVENT_DTYPE = np.dtype([("frame", "<i4"), ("substep", "<i4"), ("agent", "<i4"), ("kind", "u1")])
"""One event: the frame in which it happened, the substep in that frame, whose it was, an index into ``event_names``."""

SHARD_AGENTS = 4096
"""Most agents in a shard."""

_CHUNK_SECONDS = 20
_CHUNK_BYTES = 64 * 2**20
_CHUNK_FRAMES = 8  # at the least: with fewer, states would take more room and time than frames
_PIECE_BYTES = 2**21
_PIECES = 2  # of a chunk at the least: the fewer are left to write at its end the better


# ---- the arrays ----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ArrayLayout:
    """One zarr array of a recording.

    Attributes:
        name: Folder.
        dtype: Little-endian numpy type.
        chunk: Shape of a chunk.
        dimensions: Name of each dimension.
        unit: Of its numbers, empty where they have none.
        text: What it holds.
        agents: Of how many agents it holds rows, in its second dimension; 0 where it holds none.
    """

    name: str
    dtype: str
    chunk: tuple[int, ...]
    dimensions: tuple[str, ...]
    unit: str
    text: str
    agents: int = 0

    @property
    def nbytes(self) -> int:
        """Size of a chunk's numbers, without the checksum."""
        return math.prod(self.chunk) * np.dtype(self.dtype).itemsize

    @property
    def row(self) -> tuple[int, ...]:
        """Shape of the whole array but for its first dimension."""
        return (self.agents, *self.chunk[2:]) if self.agents else self.chunk[1:]

    @property
    def shards(self) -> int:
        """How many chunks there are along agents; along each dimension but these and the first there is one."""
        return -(-self.agents // self.chunk[1]) if self.agents else 1

    def chunk_name(self, index: int, shard: int = 0) -> str:
        """Name of the file of a chunk, ``index`` along the first dimension and ``shard`` along agents."""
        rest = [str(shard)] + ["0"] * (len(self.chunk) - 2) if len(self.chunk) > 1 else []
        return ".".join(["c", str(index), *rest])

    def metadata(self, length: int) -> dict[str, Any]:
        """What zarr's specification (version 3) asks for in zarr.json; ``length`` is that of the first dimension."""
        dtype = np.dtype(self.dtype)
        return {
            "zarr_format": 3,
            "node_type": "array",
            "shape": [length, *self.row],
            "data_type": dtype.name,
            "chunk_grid": {
                "name": "regular",
                "configuration": {"chunk_shape": [max(size, 1) for size in self.chunk]},
            },
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
            "fill_value": False if dtype.kind == "b" else 0 if dtype.kind in "iu" else 0.0,
            "codecs": [_BYTES_CODEC if dtype.itemsize > 1 else {"name": "bytes"}, {"name": "crc32c"}],
            "attributes": {"unit": self.unit, "description": self.text},
            "dimension_names": list(self.dimensions),
            "storage_transformers": [],
        }


_BYTES_CODEC = {"name": "bytes", "configuration": {"endian": "little"}}

_FRAME_ARRAYS: Sequence[tuple[str, str, tuple[str, ...], str, str]] = (
    ("link_poses", "<f4", ("frame", "agent", "link", "pose"), "m", "x y z qx qy qz qw of each link, from the origin"),
    (
        "origins",
        "<f8",
        ("frame", "agent", "xyz"),
        "m",
        "what the agent's link poses are relative to, in the world",
    ),
    ("velocities", "<f4", ("frame", "agent", "xyz"), "m/s", "velocity of the root link in the world"),
    ("desired_velocities", "<f4", ("frame", "agent", "xy"), "m/s", "velocity that the agent is asked for"),
    ("measures", "<f4", ("frame", "agent", "measure"), "", "what measure_names of the manifest say"),
    ("phases", "<i1", ("frame", "agent"), "", "index into phase_names of the manifest"),
    ("contacts", "|b1", ("frame", "agent"), "", "whether a foot is loaded"),
    ("fallen", "|b1", ("frame", "agent"), "", "whether the agent has fallen"),
    ("frozen", "|b1", ("frame", "agent"), "", "whether its state stopped being finite"),
    ("in_corral", "<i4", ("frame",), "", "how many agents are in the corral"),
    ("actor_poses", "<f8", ("frame", "actor", "pose"), "m", "x y z qx qy qz qw of each actor in the world"),
    ("controls", "<f4", ("frame", "control"), "", "what a person on the user's bicycle did, by control_names"),
)


def shard_agents(agent_count: int) -> int:
    """Agents in a shard: at most `SHARD_AGENTS`, and so many that the last one is nearly full."""
    return -(-agent_count // -(-agent_count // SHARD_AGENTS))


def frame_arrays(
    chunk_frames: int,
    agent_count: int,
    link_count: int,
    actor_count: int,
    measure_count: int = 0,
    shard: int | None = None,
    control_count: int = 0,
) -> dict[str, ArrayLayout]:
    """The arrays with one row a frame, by name; ``shard`` agents in each of their chunks, by default all."""
    sizes = {
        "frame": chunk_frames,
        "agent": agent_count if shard is None else shard,
        "link": link_count,
        "actor": actor_count,
        "measure": measure_count,
        "control": control_count,
        "pose": 7,
        "xyz": 3,
        "xy": 2,
    }
    return {
        name: ArrayLayout(
            name,
            dtype,
            tuple(sizes[d] for d in dimensions),
            dimensions,
            unit,
            text,
            agent_count if "agent" in dimensions else 0,
        )
        for name, dtype, dimensions, unit, text in _FRAME_ARRAYS
    }


def event_array(event_rows: int) -> ArrayLayout:
    """The array of events, one row each."""
    return ArrayLayout(
        "events", "<i4", (event_rows, 4), ("event", "field"), "", "frame, substep, agent, index into event_names"
    )


def state_array(parts: Sequence[StatePart]) -> ArrayLayout:
    """The array of checkpoints, one row a chunk: what is not of single agents."""
    size = sum(part.nbytes for part in parts if not part.by_agent)
    return ArrayLayout("state", "|u1", (1, size), ("chunk", "byte"), "", "state at the first frame of each chunk")


def agent_state_array(parts: Sequence[StatePart], agent_count: int, shard: int) -> ArrayLayout:
    """The array of checkpoints of agents, one row a chunk and agent."""
    size = sum(part.row_bytes for part in parts if part.by_agent)
    text = "state of each agent at the first frame of each chunk"
    return ArrayLayout("agent_state", "|u1", (1, shard, size), ("chunk", "agent", "byte"), "", text, agent_count)


def event_rows(agent_count: int) -> int:
    """Rows of a chunk of events: about what a crowd of hoppers does in a chunk of frames, a power of two."""
    return 2 ** min(max(math.ceil(math.log2(80 * agent_count)), 12), 20)


def chunk_frames(
    frame_rate: int, frame_limit: int, agent_count: int, link_count: int, actor_count: int, measure_count: int = 0
) -> int:
    """Frames in a chunk: at most twenty seconds and 64 MiB, and so many that the last chunk of the run is nearly full.

    But no fewer than eight: a chunk holds the state once, which is about as much as two frames.
    Making a file costs some 0.2 ms whatever is in it: shorter chunks would spend more on files than on their contents.
    """
    one = sum(array.nbytes for array in frame_arrays(1, agent_count, link_count, actor_count, measure_count).values())
    most = max(_CHUNK_FRAMES, min(_CHUNK_SECONDS * frame_rate, _CHUNK_BYTES // one))
    return -(-frame_limit // -(-frame_limit // most))


def piece_frames(frame_bytes: int, chunk_frames: int) -> int:
    """Frames of a chunk that are handed to the disk at once: about 2 MiB, and at most a quarter of the chunk."""
    return max(1, min(-(-chunk_frames // _PIECES), _PIECE_BYTES // frame_bytes))


def estimate_bytes(
    frame_count: int,
    agent_count: int,
    link_count: int,
    *,
    frame_rate: int = 30,
    actor_count: int = 0,
    measure_count: int = 0,
    state_bytes_per_agent: int = 512,
) -> int:
    """About how large a recording will be [bytes].

    Args:
        frame_count: Frames, the start pose included.
        agent_count: Agents.
        link_count: Most links of any body.
        frame_rate: Frames a second.
        actor_count: Actors.
        measure_count: Measures of each agent.
        state_bytes_per_agent: Size of one agent's part of the full state [bytes].
    """
    length = chunk_frames(frame_rate, frame_count, agent_count, link_count, actor_count, measure_count)
    chunks = -(-frame_count // length)
    # Events: two hops a second, each a touchdown and a liftoff, 16 bytes each.
    events = math.ceil(frame_count / frame_rate * agent_count * 4) * 16
    layouts = frame_arrays(1, agent_count, link_count, actor_count, measure_count).values()
    frames = sum(frame_count * layout.nbytes for layout in layouts)
    shards = -(-agent_count // SHARD_AGENTS)
    files = (len(layouts) + 3) * shards * (chunks + 2)  # half a block of 4 KiB is lost at the end of each
    return frames + events + chunks * agent_count * state_bytes_per_agent + 2048 * files


# ---- checkpoints ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StatePart:
    """Where one array of the full state lies among the bytes of a checkpoint, which hold the parts in order.

    Attributes:
        name, dtype: Of the array.
        shape: Of the array, of the whole crowd.
        by_agent: Whether it has a row for each agent.
    """

    name: str
    dtype: str
    shape: Annotated[tuple[int, ...], Within(at_least=0)]
    by_agent: bool = False

    def __post_init__(self) -> None:
        adopt(self, "state")
        try:
            allowed = np.dtype(self.dtype).kind in "biuf"
        except TypeError:
            allowed = False
        if not allowed:
            raise SettingError("state.dtype", f" = {self.dtype!r}: must be a type of booleans, integers or floats")

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize

    @property
    def row_bytes(self) -> int:
        """Size of a row of an array that has one for each agent."""
        return math.prod(self.shape[1:]) * np.dtype(self.dtype).itemsize


def state_parts(
    state: Mapping[str, np.ndarray], agent_state: Mapping[str, np.ndarray], agent_count: int
) -> tuple[StatePart, ...]:
    """How a state is laid out in a checkpoint: its arrays by name, in alphabetical order.

    Args:
        state: Arrays that are not of single agents.
        agent_state: Those with a row for each agent, of some or all.
        agent_count: How many agents there are.
    """
    arrays = {name: (np.asarray(array), False) for name, array in state.items()}
    arrays |= {name: (np.asarray(array), True) for name, array in agent_state.items()}
    return tuple(
        StatePart(
            name,
            array.dtype.newbyteorder("<").str,
            (agent_count, *array.shape[1:]) if by_agent else array.shape,
            by_agent,
        )
        for name, (array, by_agent) in sorted(arrays.items())
    )


def pack_state(parts: Sequence[StatePart], state: Mapping[str, np.ndarray]) -> np.ndarray:
    """What a checkpoint holds that is not of single agents, uint8, shape [bytes]."""
    arrays = (np.ascontiguousarray(state[part.name], dtype=part.dtype) for part in parts if not part.by_agent)
    return np.concatenate([np.zeros(0, np.uint8), *(array.reshape(-1).view(np.uint8) for array in arrays)])


def pack_agent_state(parts: Sequence[StatePart], state: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """What it holds of some agents, uint8, shape [1, agents, bytes]."""
    by_agent = [part for part in parts if part.by_agent]
    packed = np.empty((1, count, sum(part.row_bytes for part in by_agent)), np.uint8)
    start = 0
    for part in by_agent:
        rows = np.ascontiguousarray(state[part.name], dtype=part.dtype).reshape(count, -1)
        packed[0, :, start : start + part.row_bytes] = rows.view(np.uint8)
        start += part.row_bytes
    return packed


def unpack_state(parts: Sequence[StatePart], packed: np.ndarray, packed_agents: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of one checkpoint, by name; its bytes are of shape [bytes] and [agents, bytes]."""
    state: dict[str, np.ndarray] = {}
    start = agent_start = 0
    for part in parts:
        if part.by_agent:
            data = packed_agents[:, agent_start : agent_start + part.row_bytes].tobytes()
            agent_start += part.row_bytes
        else:
            data = packed[start : start + part.nbytes].tobytes()
            start += part.nbytes
        state[part.name] = np.frombuffer(data, dtype=part.dtype).reshape(part.shape).copy()
    return state


# ---- files ---------------------------------------------------------------------------------------------------------
def replace_file(path: Path, data: Any, checksum: bytes = b"", length: int = 0) -> None:
    """Write bytes beside ``path`` and rename, so that there is the old file or the new one, never half of one.

    Args:
        path: The file.
        data: Bytes or a contiguous array of them.
        checksum: What follows after ``length`` bytes, zeros in between; they take no space where the system knows how.
        length: At least that of ``data``, or 0 for just that.
    """
    beside = path.with_name(path.name + ".part")
    try:
        with open(beside, "wb") as file:
            file.write(data)
            if length > len(data):
                file.seek(length)
            file.write(checksum)
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def checksum(data: np.ndarray, length: int) -> bytes:
    """CRC-32C of ``data`` (uint8) followed by zeros up to ``length`` bytes, as zarr's codec stores it."""
    value = google_crc32c.value(data)  # type: ignore[arg-type]
    return checksum_bytes(checksum_with_zeros(value, length - len(data)))


def checksum_with_zeros(value: int, count: int) -> int:
    """CRC-32C of bytes whose own is ``value``, followed by ``count`` zeros."""
    for start in range(0, count, len(_ZEROS)):
        value = google_crc32c.extend(value, _ZEROS[: count - start])  # type: ignore[arg-type]
    return value


def checksum_bytes(value: int) -> bytes:
    """A CRC-32C as zarr's codec stores it."""
    return value.to_bytes(CHECKSUM_BYTES, "little")


_ZEROS = np.zeros(2**16, np.uint8)


def read_chunk(path: Path, layout: ArrayLayout, index: int) -> np.ndarray:
    """The numbers of chunk ``index`` of the recording at ``path``, all its shards; shape [rows, *layout.row].

    Raises:
        InputError: It cannot be read, or is not what was written.
    """
    if layout.shards == 1:
        return read_shard(path, layout, index, 0)
    numbers = np.empty((layout.chunk[0], *layout.row), layout.dtype)
    size = layout.chunk[1]
    for shard in range(layout.shards):
        rows = numbers[:, shard * size : (shard + 1) * size]
        rows[:] = read_shard(path, layout, index, shard)[:, : rows.shape[1]]
    return numbers


def read_shard(path: Path, layout: ArrayLayout, index: int, shard: int) -> np.ndarray:
    """The numbers of one chunk and shard, shape ``layout.chunk``; raises as `read_chunk`."""
    if not layout.nbytes:
        return np.zeros(layout.chunk, layout.dtype)
    file = path / layout.name / layout.chunk_name(index, shard)
    try:
        data = np.fromfile(file, np.uint8)
    except OSError as error:
        raise InputError(f"{file}: damaged recording: cannot be read ({error.strerror})") from None
    numbers = data[:-CHECKSUM_BYTES]
    if len(numbers) != layout.nbytes or data[-CHECKSUM_BYTES:].tobytes() != checksum(numbers, layout.nbytes):
        raise InputError(f"{file}: damaged recording: its contents do not fit their checksum")
    return numbers.view(layout.dtype).reshape(layout.chunk)
