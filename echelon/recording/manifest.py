"""The manifest of a recording: what it is, who is in it, and how much of it counts."""

from __future__ import annotations

import base64
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from echelon.errors import InputError
from echelon.recording.layout import (
    CHECKSUM_BYTES,
    MANIFEST,
    ArrayLayout,
    StatePart,
    agent_state_array,
    event_array,
    frame_arrays,
    state_array,
)
from echelon.settings import SettingError, Within, adopt, plain, read
from echelon.warp_kernels.model import Model

FORMAT = "echelon recording"
VERSION = 3
PHASE_NAMES = ("flight", "loading", "compression", "thrust", "unloading", "fallen")
EVENT_NAMES = (
    *("touchdown", "liftoff", "fall", "collision", "gate", "nonfinite", "off_road", "struck", "finish"),
    *("stand", "remove", "contact"),
)
REMOVED_PHASE = "removed"
"""Name of the phase of an agent that has been taken away: others do not see it, and nothing shows it."""


class RecordingFailed(RuntimeError):
    """A recording could not be written; the message is one line that says why and what is safe."""


# ---- who is in it --------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Cast:
    """The agents that share a body.

    Attributes:
        name: Of the character.
        body: Its links, for whoever draws them.
        first_agent: Index of the first of them among all agents.
        agent_count: How many.
        colors: Linear RGB from 0 to 1 of each individual, shape [agent_count, 3].
    """

    name: str
    body: Model
    first_agent: int
    agent_count: int
    colors: np.ndarray


@dataclass(frozen=True)
class Actor:
    """Somebody in the picture who is not simulated as a body.

    Attributes:
        name: Unique name.
        kind: What it looks like, for example "bicycle".
    """

    name: str
    kind: str


# ---- the manifest --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class CastEntry:
    """A `Cast` as plain data; its colours, maybe a hundred thousand, as base64 of little-endian float64."""

    name: str
    body: dict
    first_agent: Annotated[int, Within(at_least=0)]
    agent_count: Annotated[int, Within(at_least=1)]
    colors: str

    def __post_init__(self) -> None:
        adopt(self, "casts")
        try:
            values = self.color_values()
        except ValueError:
            raise SettingError("casts.colors", ": must be numbers in base64") from None
        if len(values) != self.agent_count or not np.all((values >= 0.0) & (values <= 1.0)):
            text = f": must be {self.agent_count}, one for each agent, of numbers from 0 to 1"
            raise SettingError("casts.colors", text)

    def color_values(self) -> np.ndarray:
        """Linear RGB of each individual, shape [agents, 3]; raises ValueError where they are damaged."""
        return np.frombuffer(base64.b64decode(self.colors, validate=True), "<f8").reshape(-1, 3)


@dataclass(frozen=True)
class ActorEntry:
    """An `Actor` as plain data."""

    name: str
    kind: str

    def __post_init__(self) -> None:
        adopt(self, "actors")


@dataclass(frozen=True)
class Manifest:
    """What a recording is, and how much of it counts. Everything in it is a function of the run alone.

    Attributes:
        status: "running" until the run has come to its end.
        frame_rate: Frames a second.
        frame_limit: The most frames that the run can have, the start pose included.
        chunk_frames: Frames in every chunk but the last.
        frame_count, chunk_count, event_count: How much counts.
        link_count: Most links of any body.
        agent_count: In all casts.
        shard_agents: Agents in every shard but the last.
        event_rows: Rows of a chunk of the event array.
        control_names: What a person did in each frame; empty where nobody rode.
        scenario, world, summary: Plain data.
        state: Parts of a checkpoint, in order; empty until the first chunk.
    """

    format: str
    version: int
    status: Literal["running", "done"]
    frame_rate: Annotated[int, Within(at_least=1)]
    frame_limit: Annotated[int, Within(at_least=1)]
    chunk_frames: Annotated[int, Within(at_least=1)]
    frame_count: Annotated[int, Within(at_least=0)]
    chunk_count: Annotated[int, Within(at_least=0)]
    event_count: Annotated[int, Within(at_least=0)]
    event_rows: Annotated[int, Within(at_least=1)]
    agent_count: Annotated[int, Within(at_least=1)]
    shard_agents: Annotated[int, Within(at_least=1)]
    link_count: Annotated[int, Within(at_least=1)]
    phase_names: tuple[str, ...]
    measure_names: tuple[str, ...]
    control_names: tuple[str, ...]
    event_names: tuple[str, ...]
    actors: tuple[ActorEntry, ...]
    casts: tuple[CastEntry, ...]
    scenario: dict
    world: dict
    state: tuple[StatePart, ...] = ()
    summary: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        adopt(self, "")
        if self.chunk_count != -(-self.frame_count // self.chunk_frames):
            raise SettingError("chunk_count", f" = {self.chunk_count}: does not fit {self.frame_count} frames")
        if self.frame_count > self.frame_limit:
            raise SettingError("frame_count", f" = {self.frame_count}: must be at most {self.frame_limit}")
        if sum(cast.agent_count for cast in self.casts) != self.agent_count:
            raise SettingError("agent_count", f" = {self.agent_count}: must be that of all casts")

    def constant_text(self) -> str:
        """What stays the same while the run goes on, as JSON; made once, for a large crowd takes its time."""
        data = plain(self)
        return json.dumps({key: data[key] for key in data if key not in _CHANGING}, allow_nan=False)


_CHANGING = ("status", "frame_count", "chunk_count", "event_count", "state", "summary")


def manifest_text(
    constant: str,
    *,
    status: str = "running",
    frame_count: int = 0,
    chunk_count: int = 0,
    event_count: int = 0,
    state: Sequence[StatePart] = (),
    summary: Mapping[str, Any] | None = None,
) -> str:
    """The manifest as it stands in its file: what changes, then what stays the same (`Manifest.constant_text`)."""
    changing = {
        "status": status,
        "frame_count": frame_count,
        "chunk_count": chunk_count,
        "event_count": event_count,
        "state": [plain(part) for part in state],
        "summary": dict(summary or {}),
    }
    return f"{json.dumps(changing, allow_nan=False)[:-1]}, {constant[1:]}\n"


def read_manifest(path: Path) -> Manifest:
    """The manifest of the recording at ``path``.

    Raises:
        InputError: There is no such folder, it is no recording, or its manifest is damaged or of an unknown version.
    """
    where = path / MANIFEST
    if not path.exists():
        raise InputError(f"{path}: no such recording")
    try:
        data = json.loads(where.read_bytes().decode("utf-8"), parse_constant=_refuse_constant)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: not a recording; must be a folder that holds a {MANIFEST}") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError):
        raise InputError(f"{where}: damaged; must be the manifest of a recording (JSON)") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise InputError(f"{where}: not the manifest of a recording; its format must be {FORMAT!r}")
    if data.get("version") != VERSION:
        raise InputError(f"{where}: version = {data.get('version')!r}: this Echelon reads version {VERSION}")
    try:
        return read(Manifest, data)
    except SettingError as error:
        raise InputError(f"{where}: damaged: {error}") from None


def is_recording(path: Path) -> bool:
    """Whether there is a recording at ``path``, of whatever version, so that it may be replaced by another."""
    try:
        data = json.loads((path / MANIFEST).read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and data.get("format") == FORMAT


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def manifest_frame_arrays(manifest: Manifest) -> dict[str, ArrayLayout]:
    """`frame_arrays` of one recording."""
    return frame_arrays(
        manifest.chunk_frames,
        manifest.agent_count,
        manifest.link_count,
        len(manifest.actors),
        len(manifest.measure_names),
        manifest.shard_agents,
        len(manifest.control_names),
    )


def check_chunks(path: Path, manifest: Manifest) -> None:
    """Check that every chunk that the manifest counts is there, in full length.

    Raises:
        InputError: One is missing or too short or too long, or an array is described otherwise than the manifest says.
    """
    arrays = [(layout, manifest.chunk_count) for layout in manifest_frame_arrays(manifest).values()]
    arrays.append((event_array(manifest.event_rows), -(-manifest.event_count // manifest.event_rows)))
    if manifest.chunk_count:
        if not manifest.state:
            raise InputError(f"{path / MANIFEST}: damaged: state: must be there once there are frames")
        arrays.append((state_array(manifest.state), manifest.chunk_count))
        agents = agent_state_array(manifest.state, manifest.agent_count, manifest.shard_agents)
        if agents.nbytes:
            arrays.append((agents, manifest.chunk_count))
    for layout, chunk_count in arrays:
        folder = path / layout.name
        try:
            described = json.loads((folder / "zarr.json").read_bytes())
            sizes = {entry.name: entry.stat().st_size for entry in os.scandir(folder)}
        except (OSError, ValueError, RecursionError):
            raise InputError(f"{folder}: damaged; must be the array {layout.name!r} of a recording") from None
        shape = described.get("shape") if isinstance(described, dict) else None
        length = shape[0] if isinstance(shape, list) and shape else None
        if type(length) is not int or described != layout.metadata(length):
            raise InputError(f"{folder / 'zarr.json'}: damaged; does not describe what the manifest says")
        files = itertools.product(range(chunk_count if layout.nbytes else 0), range(layout.shards))
        for index, shard in files:
            name, whole = layout.chunk_name(index, shard), layout.nbytes + CHECKSUM_BYTES
            if sizes.get(name) != whole:
                found = f"has {sizes[name]} bytes" if name in sizes else "is missing"
                raise InputError(f"{folder / name}: truncated recording: this chunk {found}; must have {whole}")
