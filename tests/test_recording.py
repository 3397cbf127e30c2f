"""Recordings: what is written is read, and what is killed is gone on with to the same bytes.

Run as a program, this file writes the recording that the tests kill: ``python test_recording.py PATH``.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.recording import (
    EVENT_DTYPE,
    Actor,
    Cast,
    Recording,
    RecordingFailed,
    RecordingWriter,
    estimate_bytes,
)
from echelon.recording import layout as recording_layout
from echelon.warp_kernels.model import Joint, Link, Model

AGENTS, LINKS, FRAMES, CHUNK = 5, 3, 233, 20
UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def three_link_body() -> Model:
    root = Link("body", None, Joint("root", "free"), 1.0, inertia=UNIT)
    upper = Link("upper", "body", Joint("hip", "ball"), 1.0, inertia=UNIT)
    lower = Link("lower", "upper", Joint("knee", "pin", axes=((0.0, 1.0, 0.0),)), 1.0, inertia=UNIT)
    return Model("three", (root, upper, lower))


class Walk:
    """A toy simulation: a chaotic map an agent, so that one wrong bit in the state changes all that follows."""

    def __init__(self) -> None:
        self.x = np.linspace(0.1, 0.9, AGENTS)
        self.frame = np.array(0, np.int64)

    def state(self) -> dict[str, np.ndarray]:
        return {"x": self.x.copy(), "frame": self.frame.copy()}

    def load(self, state: dict[str, np.ndarray]) -> None:
        self.x, self.frame = state["x"], state["frame"]

    def record(self, row: int, frames: dict[str, np.ndarray]) -> list[tuple[int, int, int, int]]:
        x, frame = self.x, int(self.frame)
        frames["link_poses"][row] = x[:, None, None] * np.arange(1, 8) + np.arange(LINKS)[:, None]
        frames["origins"][row] = 1e4 + x[:, None] * [1.0, 2.0, 3.0]
        frames["velocities"][row] = x[:, None] - frame
        frames["desired_velocities"][row] = -x[:, None]
        frames["measures"][row] = x[:, None] * [100.0, 3.0]
        frames["phases"][row] = (x * 5).astype(np.int8)
        frames["contacts"][row] = x > 0.5
        frames["fallen"][row] = x > 0.9
        frames["frozen"][row] = x > 0.99
        frames["in_corral"][row] = np.count_nonzero(x < 0.2)
        frames["actor_poses"][row] = x.sum()
        frames["controls"][row] = x[0] * np.array([1.0, -2.0, 0.5])
        # Out of order on purpose: the writer sorts.
        events = [(frame, 39 - agent, agent, int(10 * x[agent]) % 6) for agent in range(AGENTS) if x[agent] > 0.3]
        self.x = 3.9 * x * (1.0 - x)
        self.frame = self.frame + 1
        return events


def begin(path: Path, frames: int = FRAMES) -> RecordingWriter:
    return RecordingWriter.create(
        path,
        scenario={"name": "walk", "seconds": 7.75},
        frame_rate=30,
        frame_limit=frames,
        casts=[Cast("three", three_link_body(), 0, AGENTS, np.linspace(0, 1, AGENTS * 3).reshape(AGENTS, 3))],
        world={"ground": {"shape": "plane", "half_size": 10.0}},
        actors=[Actor("collie", "bicycle")],
        measure_names=("power", "lean"),
        control_names=("effort", "brake", "gear"),
        length=CHUNK,
    )


def go_on(writer: RecordingWriter, state: dict[str, np.ndarray] | None, pause: float = 0.0) -> None:
    """Walk to the end of the recording from ``state``."""
    walk = Walk()
    if state is not None:
        walk.load(state)
    buffers, piece = writer.buffers(), 3  # frames at once, in some chunks; others are given whole
    with writer:
        while writer.next_frame < writer.frame_limit:
            count = min(CHUNK, writer.frame_limit - writer.next_frame)
            start, events = walk.state(), []
            in_pieces = writer.next_frame // CHUNK % 2 == 0
            if in_pieces:
                writer.begin_chunk(start)
            for row in range(count):
                events += walk.record(row, buffers)
                if in_pieces and (row % piece == piece - 1 or row == count - 1):
                    writer.extend({name: array[row - row % piece : row + 1] for name, array in buffers.items()})
            table = np.array(events, EVENT_DTYPE)
            if in_pieces:
                writer.end_chunk(table)
            else:
                writer.append({name: array[:count] for name, array in buffers.items()}, start, table)
            time.sleep(pause)
        writer.finish({"frames": FRAMES, "state_hash": walk.x.tobytes().hex()})


def walked() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What the whole recording must hold: arrays by name, and events."""
    walk, events = Walk(), []
    shapes = {name: (FRAMES, *shape[1:]) for name, shape in buffer_shapes().items()}
    frames = {name: np.zeros(shape, buffer_types()[name]) for name, shape in shapes.items()}
    for row in range(FRAMES):
        events += walk.record(row, frames)
    return frames, np.sort(np.array(events, EVENT_DTYPE), order=["frame", "substep", "agent", "kind"])


def buffer_shapes() -> dict[str, tuple[int, ...]]:
    layouts = recording_layout.frame_arrays(CHUNK, AGENTS, LINKS, 1, 2, control_count=3)
    return {name: layout.chunk for name, layout in layouts.items()}


def buffer_types() -> dict[str, np.dtype]:
    layouts = recording_layout.frame_arrays(CHUNK, AGENTS, LINKS, 1, 2)
    return {name: np.dtype(layout.dtype) for name, layout in layouts.items()}


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of an uninterrupted run; not to be changed."""
    path = tmp_path_factory.mktemp("whole") / "walk.recording"
    go_on(begin(path), None)
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "copy.recording"))


# ---- reading -------------------------------------------------------------------------------------------------------
def test_what_was_written_is_read(whole: Path) -> None:
    recording = Recording(whole)
    frames, events = walked()
    poses = frames["link_poses"].astype(np.float64)
    poses[..., :3] += frames["origins"][:, :, None]
    np.testing.assert_array_equal(recording.link_poses, poses)
    assert recording.link_poses.dtype == np.float64
    for name in set(frames) - {"link_poses", "origins"}:
        lazy = getattr(recording, name)
        assert lazy.dtype == frames[name].dtype
        assert lazy.shape == frames[name].shape
        np.testing.assert_array_equal(lazy[:], frames[name])
    np.testing.assert_array_equal(recording.events, events)
    np.testing.assert_array_equal(recording.times, np.arange(FRAMES) / 30)
    assert recording.status == "done"
    assert recording.frame_count == FRAMES
    assert recording.scenario == {"name": "walk", "seconds": 7.75}
    assert recording.casts[0].body == three_link_body()
    np.testing.assert_array_equal(recording.casts[0].colors, np.linspace(0, 1, AGENTS * 3).reshape(AGENTS, 3))
    assert recording.actors == (Actor("collie", "bicycle"),)
    assert recording.summary["frames"] == FRAMES


def test_states_are_those_at_the_first_frame_of_each_chunk(whole: Path) -> None:
    recording, walk, frames = Recording(whole), Walk(), {n: np.zeros(s) for n, s in buffer_shapes().items()}
    for frame in range(FRAMES):
        if frame % CHUNK == 0:
            state = recording.state(frame // CHUNK)
            np.testing.assert_array_equal(state["x"], walk.x)
            assert state["frame"] == frame
        walk.record(0, frames)
    with pytest.raises(IndexError):
        recording.state(-(-FRAMES // CHUNK))


@pytest.mark.parametrize(
    "key",
    [
        7,
        -1,
        np.int64(150),
        slice(None),
        slice(18, 43),
        slice(200, 10, -7),
        slice(5, 5),
        slice(3, None, 25),
        [3, 1, 199, 1],
        [],
        np.arange(FRAMES) % 3 == 0,
        np.array([[1, 2], [222, 4]]),
        ...,
        (slice(None), 2),
        (slice(0, 50), slice(1, 4), 0),
        (3, [0, 2]),
        (-3, ..., 1),
        (slice(10, 90), [4, 0], 1),
        (slice(10, 90), slice(None), [1, 0]),
        ([1, 80], [2, 3]),
        (..., slice(0, 2)),
        (slice(None), np.array([True, False, True, False, True])),
        (),
    ],
    ids=str,
)
def test_lazy_arrays_are_indexed_as_arrays_are(whole: Path, key: Any) -> None:
    lazy = Recording(whole).velocities
    np.testing.assert_array_equal(lazy[key], np.asarray(lazy)[key])


@pytest.mark.parametrize("key", [FRAMES, -FRAMES - 1, (0, AGENTS), (0, 0, 0, 0), None, [FRAMES], (..., ...)], ids=str)
def test_wrong_indices_are_index_errors(whole: Path, key: Any) -> None:
    with pytest.raises(IndexError):
        Recording(whole).velocities[key]


def test_only_the_chunk_that_is_asked_for_is_read(copy: Path) -> None:
    file = copy / "velocities" / "c.3.0.0"
    file.write_bytes(b"\0" * file.stat().st_size)
    lazy = Recording(copy).velocities
    assert np.isfinite(lazy[: 3 * CHUNK]).all()
    assert np.isfinite(lazy[4 * CHUNK :]).all()
    with pytest.raises(InputError, match="checksum"):
        lazy[3 * CHUNK]


def test_zarr_reads_the_same(whole: Path) -> None:
    import zarr

    recording = Recording(whole)
    frames, _ = walked()
    group = zarr.open_group(whole, mode="r")
    for name, array in frames.items():
        stored = group[name]
        assert isinstance(stored, zarr.Array)
        assert stored.shape == array.shape
        assert stored.dtype == array.dtype
        np.testing.assert_array_equal(np.asarray(stored[:]), array)
    events = group["events"]
    assert isinstance(events, zarr.Array)
    assert events.shape == (len(recording.events), 4)
    np.testing.assert_array_equal(np.asarray(events[:])[:, 2], recording.events["agent"])
    assert events.metadata.dimension_names == ("event", "field")  # type: ignore[union-attr]


def test_a_recording_without_actors_or_events(tmp_path: Path) -> None:
    body = three_link_body()
    with RecordingWriter.create(
        tmp_path / "empty",
        scenario={},
        frame_rate=24,
        frame_limit=50,
        casts=[Cast("three", body, 0, 1, np.ones((1, 3)))],
        world={},
    ) as writer:
        frames = {name: array[:9] for name, array in writer.buffers().items()}
        writer.append(frames, {"x": np.zeros(1)})
        writer.finish({})
    recording = Recording(tmp_path / "empty")
    assert recording.frame_count == 9
    assert recording.actor_poses[:].shape == (9, 0, 7)
    assert recording.measures[:].shape == (9, 1, 0)
    assert recording.events.shape == (0,)
    assert recording.events.dtype == EVENT_DTYPE


# ---- interruptions -------------------------------------------------------------------------------------------------
def test_the_same_run_gives_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    go_on(begin(tmp_path / "again"), None)
    assert contents(tmp_path / "again") == contents(whole)


class PowerCut(BaseException):
    """The end of the process, as far as what is on disk can tell."""


def test_cut_off_at_every_single_file(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends at the n-th renaming, for every n: it opens, and goes on to the same bytes."""
    expected, replace = contents(whole), os.replace
    renamings = 0

    def count(*names: Path) -> None:
        nonlocal renamings
        renamings += 1
        if renamings == limit:
            raise PowerCut
        replace(*names)

    limit, cuts = 3, 0  # the first two renamings put the empty recording in its place
    while True:
        path = tmp_path / f"cut{limit}"
        renamings = 0
        monkeypatch.setattr(os, "replace", count)
        try:
            go_on(begin(path), None)
        except PowerCut:
            cuts += 1
        else:
            break
        finally:
            monkeypatch.setattr(os, "replace", replace)
        (path / "link_poses" / "c.9.0.0.0.part").write_bytes(b"half of a chunk")
        (path / "recording.json.part").write_bytes(b"half of a manifest")

        opened = Recording(path)
        assert opened.status == "running"
        assert opened.frame_count % CHUNK == 0 or opened.frame_count == FRAMES
        frames, events = walked()
        np.testing.assert_array_equal(opened.velocities, frames["velocities"][: opened.frame_count])
        np.testing.assert_array_equal(opened.events, events[events["frame"] < opened.frame_count])

        writer, state = RecordingWriter.reopen(path)
        assert (state is None) == (opened.frame_count == 0)
        go_on(writer, state)
        assert contents(path) == expected
        shutil.rmtree(path)
        limit += 7  # a number that has no factor in common with that of the files in a chunk
    assert cuts > 15


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs a system with SIGKILL")
@pytest.mark.parametrize("attempt", range(5))
def test_killed_at_a_random_moment(whole: Path, tmp_path: Path, attempt: int) -> None:
    path = tmp_path / "killed"
    process = subprocess.Popen([sys.executable, __file__, str(path)])
    try:
        deadline = time.monotonic() + 60
        while not path.exists() and time.monotonic() < deadline:
            time.sleep(0.002)
        time.sleep(random.Random(attempt).uniform(0.0, 0.5))
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    opened = Recording(path)
    assert len(opened.link_poses[:]) == opened.frame_count
    if opened.status == "running":  # and not, on a machine that was long in killing it, at its end
        go_on(*RecordingWriter.reopen(path))
    assert contents(path) == contents(whole)


def test_a_resumed_run_that_differs_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "walk"
    with pytest.raises(PowerCut):
        interrupted(path)
    writer, state = RecordingWriter.reopen(path)
    assert state is not None
    state["x"] = np.nextafter(state["x"], 1.0)
    with pytest.raises(RecordingFailed, match="came out differently"):
        go_on(writer, state)


def test_resumed_events_that_differ_are_found_out(tmp_path: Path) -> None:
    path = tmp_path / "walk"
    with pytest.raises(PowerCut):
        interrupted(path)
    for change in ("fewer", "other"):
        writer, state = RecordingWriter.reopen(path)
        assert state is not None
        walk, frames, events = Walk(), writer.buffers(), []
        walk.load(state)
        for row in range(CHUNK):
            events += walk.record(row, frames)
        table = np.array(events, EVENT_DTYPE)
        table["agent"][-1] += change == "other"
        with writer, pytest.raises(RecordingFailed, match="events came out differently"):
            writer.append(frames, state, table[: -1 if change == "fewer" else None])


def interrupted(path: Path, after: int = 3) -> None:
    """A recording of which ``after`` chunks are on disk, left by PowerCut."""
    walk = Walk()
    with begin(path) as writer:
        for _ in range(after):
            frames, start, events = writer.buffers(), walk.state(), []
            for row in range(CHUNK):
                events += walk.record(row, frames)
            writer.append(frames, start, np.array(events, EVENT_DTYPE))
        raise PowerCut


def test_a_finished_recording_is_not_resumed(whole: Path) -> None:
    with pytest.raises(InputError, match=r"finished \(233 frames\)"):
        RecordingWriter.reopen(whole)


@pytest.mark.skipif(sys.platform != "linux", reason="locks are tested where they are known to work")
def test_two_writers_at_once_are_refused(tmp_path: Path) -> None:
    with begin(tmp_path / "walk"):
        with pytest.raises(InputError, match="another run"):
            RecordingWriter.reopen(tmp_path / "walk")
        with pytest.raises(InputError, match="another run"):
            begin(tmp_path / "walk")
    writer, state = RecordingWriter.reopen(tmp_path / "walk")
    assert state is None
    writer.close()


# ---- damage --------------------------------------------------------------------------------------------------------
def one_line(error: pytest.ExceptionInfo[InputError], path: Path) -> str:
    text = str(error.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def test_a_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such recording") as error:
        Recording(tmp_path / "nothing")
    one_line(error, tmp_path)
    for foreign in (tmp_path, Path(__file__)):
        with pytest.raises(InputError, match="not a recording") as error:
            Recording(foreign)
        one_line(error, foreign)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "damaged"),
        ("{", "damaged"),
        ("[" * 100_000, "damaged"),
        ("\ud83d".encode("utf-8", "surrogatepass"), "damaged"),
        ("[1, 2]", "not the manifest of a recording"),
        ('{"format": "something else"}', "not the manifest of a recording"),
        ('{"format": "echelon recording", "version": 2}', "version = 2: this Echelon reads version 3"),
        ('{"format": "echelon recording"}', "version = None"),
        ('{"format": "echelon recording", "version": 3}', "is missing"),
        ('{"format": "echelon recording", "version": 3, "frame_rate": NaN}', "damaged"),
    ],
)
def test_a_damaged_manifest(copy: Path, text: str | bytes, message: str) -> None:
    (copy / "recording.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    for act in (Recording, RecordingWriter.reopen):
        with pytest.raises(InputError, match=message) as error:
            act(copy)
        one_line(error, copy)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("frame_count", FRAMES + 500, "does not fit"),
        ("frame_count", "233", "whole number"),
        ("frame_count", -1, "at least 0"),
        ("frame_rate", 0, "at least 1"),
        ("status", "paused", "one of"),
        ("agent_count", AGENTS + 1, "all casts"),
        ("link_count", LINKS + 1, "does not describe"),
        ("casts", [], "all casts"),
        ("state", [], "state"),
        ("state", [{"name": "x", "dtype": "O", "shape": [1]}], "dtype"),
        ("event_count", 10**6, "missing"),
        ("event_rows", 77, "does not describe"),
        ("surprise", 1, "unknown key"),
        ("chunk_frames", 10**9, "does not"),
    ],
)
def test_a_manifest_that_says_something_else(copy: Path, key: str, value: object, message: str) -> None:
    data = json.loads((copy / "recording.json").read_text())
    (copy / "recording.json").write_text(json.dumps({**data, key: value}))
    with pytest.raises(InputError, match=message) as error:
        Recording(copy)
    one_line(error, copy)


def test_a_body_that_is_none(copy: Path) -> None:
    data = json.loads((copy / "recording.json").read_text())
    data["casts"][0]["body"]["links"][1]["parent"] = "nobody"
    (copy / "recording.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="nobody") as error:
        Recording(copy)
    one_line(error, copy)


@pytest.mark.parametrize("name", [*buffer_shapes(), "events", "state"])
@pytest.mark.parametrize("damage", ["remove", "truncate", "lengthen", "description"])
def test_a_truncated_recording(copy: Path, name: str, damage: str) -> None:
    file = sorted((copy / name).glob("c.*"))[-1]
    match damage:
        case "remove":
            file.unlink()
        case "truncate":
            file.write_bytes(file.read_bytes()[:-1])
        case "lengthen":
            file.write_bytes(file.read_bytes() + b"\0")
        case _:
            (copy / name / "zarr.json").write_text("{}")
    with pytest.raises(InputError, match=r"truncated|damaged") as error:
        Recording(copy)
    one_line(error, copy)


def test_one_wrong_bit_is_found(copy: Path) -> None:
    for name in (*buffer_shapes(), "events", "state"):
        file = min((copy / name).glob("c.*"))
        data = bytearray(file.read_bytes())
        data[len(data) // 3] ^= 4
        file.write_bytes(data)
    recording = Recording(copy)
    lazy = [getattr(recording, name) for name in buffer_shapes() if name != "origins"]
    for read in [*(array.__getitem__ for array in lazy), recording.state, lambda _: recording.events]:
        with pytest.raises(InputError, match="checksum") as error:
            read(0)
        one_line(error, copy)


# ---- places --------------------------------------------------------------------------------------------------------
def test_only_a_recording_is_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "work.txt").write_text("years of it")
    (tmp_path / "file").write_text("a file")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "recording.json").write_text('{"format": "of somebody else"}')
    for path in (precious, tmp_path / "file", tmp_path / "other", tmp_path):
        before = contents(tmp_path)
        with pytest.raises(InputError, match="not a recording") as error:
            begin(path)
        one_line(error, path)
        assert contents(tmp_path) == before


def test_a_recording_is_replaced(whole: Path, copy: Path) -> None:
    (copy / "link_poses" / "c.99.0.0.0").write_bytes(b"of a longer run")
    go_on(begin(copy), None)
    assert contents(copy) == contents(whole)
    assert sorted(entry.name for entry in copy.parent.iterdir()) == [copy.name]


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder") as error:
        begin(tmp_path / "no" / "walk")
    one_line(error, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="there is no folder") as error:
        begin(tmp_path / "file" / "walk")
    one_line(error, tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does")
def test_a_full_disk(tmp_path: Path) -> None:
    """A limit on the size of files stands for a full disk: writing fails midway, and what was there is safe."""
    path = tmp_path / "walk"
    with begin(path) as writer:
        frames = writer.buffers()
        writer.append(frames, Walk().state())
        writer.append(frames, Walk().state())
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
        try:
            with pytest.raises(
                RecordingFailed, match=r"its first 40 frames are safe \(at most a chunk, 20 frames, is lost\)"
            ) as error:
                writer.append(frames, Walk().state())
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert "\n" not in str(error.value)
    assert Recording(path).frame_count == 2 * CHUNK
    assert not list(path.rglob("*.part"))


# ---- misuse and size -----------------------------------------------------------------------------------------------
def test_arrays_of_the_wrong_shape_or_type_are_refused(tmp_path: Path) -> None:
    with begin(tmp_path / "walk") as writer:
        frames, state = writer.buffers(), Walk().state()
        with pytest.raises(ValueError, match="velocities"):
            writer.append({**frames, "velocities": frames["velocities"][:, 1:]}, state)
        with pytest.raises(ValueError, match="contacts"):
            writer.append({**frames, "contacts": frames["phases"]}, state)
        with pytest.raises(ValueError, match="outside of this chunk"):
            writer.append(frames, state, np.array([(CHUNK, 0, 0, 0)], EVENT_DTYPE))
        writer.append(frames, state)
        with pytest.raises(ValueError, match="state"):
            writer.append(frames, {"x": state["x"]})
        writer.append({name: array[:3] for name, array in frames.items()}, state)
        with pytest.raises(ValueError, match="last chunk"):
            writer.append(frames, state)


def test_the_estimate_of_size(tmp_path: Path) -> None:
    """Within a tenth of what a herd of some size takes."""
    agents, frames = 40, 901
    body = three_link_body()
    with RecordingWriter.create(
        tmp_path / "size",
        scenario={},
        frame_rate=30,
        frame_limit=frames,
        casts=[Cast("three", body, 0, agents, np.ones((agents, 3)))],
        world={},
        measure_names=("power", "lean"),
    ) as writer:
        buffers, state = writer.buffers(), {"x": np.zeros((agents, 128), np.float32)}
        while writer.next_frame < frames:
            count = min(writer.chunk_frames, frames - writer.next_frame)
            events = np.zeros(count * agents * 4 // 30, EVENT_DTYPE)
            events["frame"] = writer.next_frame
            writer.append({name: array[:count] for name, array in buffers.items()}, state, events)
        writer.finish({})
    size = sum(file.stat().st_size for file in (tmp_path / "size").rglob("*") if file.is_file())
    assert estimate_bytes(frames, agents, LINKS, measure_count=2) == pytest.approx(size, rel=0.1)


def test_recording_costs_little(tmp_path: Path) -> None:
    """105 agents of 3 links: some 0.5 ms of processor time a simulated second; tested with room for a busy machine."""
    agents, seconds = 105, 40
    with RecordingWriter.create(
        tmp_path / "speed",
        scenario={},
        frame_rate=30,
        frame_limit=30 * seconds,
        casts=[Cast("three", three_link_body(), 0, agents, np.ones((agents, 3)))],
        world={},
    ) as writer:
        buffers, state = writer.buffers(), {"x": np.zeros((agents, 128), np.float32)}
        started = time.process_time()
        while writer.next_frame < 30 * seconds:
            events = np.zeros(writer.chunk_frames * agents * 4 // 30, EVENT_DTYPE)
            events["frame"] = writer.next_frame
            writer.append(buffers, state, events)
        writer.finish({})
        spent = time.process_time() - started
    assert spent / seconds < 5e-3


if __name__ == "__main__":
    go_on(begin(Path(sys.argv[1])), None, pause=0.05)
