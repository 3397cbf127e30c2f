"""What goes wrong with a run from outside: memory, disks, kills, a cold cache. It harms nothing else, and is said.

Runs are real processes of the command, faults real ones of the system where it lets us.
"""

from __future__ import annotations

import ctypes
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation
from echelon.warp_kernels.character import LOST, REMOVED
from tests.simulation.falls import Blow, recorded, same_files, struck

COMMAND = [sys.executable, "-c", "import sys; from echelon.cli import run; sys.exit(run(sys.argv[1:]))"]
RUN = ["simulate", "herd", "--agents", "4", "--seconds", "400", "--quiet", "--recording"]
FRAMES = 12_001
CAP_DAC_OVERRIDE, PR_CAPBSET_DROP = 1, 24

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="faults are made as Linux makes them")


# ---- a state that is not finite --------------------------------------------------------------------------------------
def flagged(agent: int, flag: float) -> Blow:
    """An agent is frozen, or gone, without anything being wrong with its numbers."""

    def give(simulation: Simulation) -> None:
        host = simulation.engine.state.numpy()
        block, lane = divmod(agent, simulation.engine.lanes)
        host[block, simulation.engine.layout.frozen, lane] = flag

    return give


def poisoned(agent: int, place: str, value: float) -> Blow:
    """One number of an agent's state is ruined: a speed, its attitude, its place, or its controller's memory."""

    def give(simulation: Simulation) -> None:
        engine = simulation.engine
        layout = engine.layout
        memory = "heading" if "heading" in layout.memory else "power"
        at = {"speed": layout.u + 2, "attitude": layout.q + 4, "place": layout.q, "memory": layout.memory[memory]}
        block, lane = divmod(agent, engine.lanes)
        engine.state.numpy()[block, at[place], lane] = value

    return give


def left_by(plan: Scenario, path: Path, agent: int, blow: Blow) -> dict[str, np.ndarray]:
    """All that a run left of everybody else, when an agent gets a blow before frame 30."""
    with pytest.MonkeyPatch.context() as patch:
        struck(patch, 30, blow)
        recording = recorded(plan, path)
    assert recording.summary["nonfinite"] <= 1
    assert recording.frozen[:].any(axis=0).sum() <= 1
    arrays = {name: getattr(recording, name)[:] for name in ("link_poses", "velocities", "measures", "phases")}
    arrays |= {"desired": recording.desired_velocities[:], "fallen": recording.fallen[:]}
    found = {name: np.delete(array, agent, axis=1) for name, array in arrays.items()}
    found["actors"] = recording.actor_poses[:]
    table = recording.events
    return found | {"events": table[table["agent"] != agent]}


PLANS = {
    "field": Scenario.load("border-collie", ["seconds=4", "until=''", "crowd.start_spacing=1.2"]),
    "road": Scenario.load("corner", ["seconds=3", "crowd.count=6", "peloton.drafting=true"]),
}


@pytest.mark.parametrize("world", ["field", "road"])
def test_a_ruined_state_harms_no_other_bit(world: str, tmp_path: Path) -> None:
    """Others do as they do when it is frozen, or not seen, and nothing is wrong with it."""
    plan, agent = PLANS[world], 3
    expected = left_by(plan, tmp_path / "frozen", agent, flagged(agent, LOST))
    unseen = left_by(plan, tmp_path / "gone", agent, flagged(agent, REMOVED))
    assert not np.array_equal(expected["desired"], unseen["desired"])  # others do look at it
    for place, value in (
        ("speed", np.nan),
        ("speed", 1e30),
        ("attitude", np.nan),
        ("memory", np.inf),
        ("place", np.nan),
    ):
        found = left_by(plan, tmp_path / "ruined", agent, poisoned(agent, place, value))
        alike = unseen if place == "place" else expected
        for name, array in found.items():
            np.testing.assert_array_equal(array, alike[name], err_msg=f"{place} = {value}: {name}")
            assert name == "events" or np.isfinite(array.astype(float)).all()


# ---- runs that are cut short -----------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the run that nothing happens to."""
    path = tmp_path_factory.mktemp("whole") / "run"
    subprocess.run([*COMMAND, *RUN, str(path)], check=True)
    return path


def recorded_frames(path: Path) -> int:
    """Frames that count so far; 0 where there is no recording yet."""
    try:
        return Recording(path).frame_count
    except InputError:
        return 0


def cut_short(
    path: Path, fault: Callable[[subprocess.Popen[str]], None], before: Callable[[], None] | None = None
) -> str:
    """Begin the run, bring a fault about once a chunk has been recorded, and give what it said of it."""
    process = subprocess.Popen([*COMMAND, *RUN, str(path)], stderr=subprocess.PIPE, text=True, preexec_fn=before)
    deadline = time.monotonic() + 120
    while recorded_frames(path) == 0 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    fault(process)
    reached = recorded_frames(path)
    said = process.communicate(timeout=120)[1]
    left = Recording(path)
    assert left.status == "running"
    # What had been recorded when it happened still is.
    assert 0 < reached <= left.frame_count < FRAMES
    assert left.frame_count % left.chunk_frames == 0
    assert process.returncode == (-signal.SIGKILL if not said else 1)
    return said


def goes_on(path: Path, whole: Path) -> None:
    """The rest of the run brings it to the bytes of the one that nothing happened to."""
    subprocess.run([*COMMAND, "resume", str(path), "--quiet"], check=True)
    assert same_files(path, whole)


def one_line(said: str, path: Path, reason: str) -> None:
    assert said.count("\n") == 1, said
    assert str(path) in said
    assert reason in said
    assert "frames are safe (at most a chunk" in said
    assert "can be resumed" in said


def test_killed_it_loses_no_chunk_that_was_recorded(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"
    assert cut_short(path, lambda process: process.kill()) == ""
    goes_on(path, whole)


TELLING = """
import os, sys
from echelon.recording import layout
layout._CHUNK_SECONDS = 1
from echelon.scenario import Scenario
from echelon.simulation import resume, simulate
def say(done, total):
    os.write(1, done.to_bytes(4, "little"))
if os.path.exists(sys.argv[1]):
    resume(sys.argv[1], progress=say)
else:
    plan = Scenario.load("herd", ["crowd.count=4", "seconds=20"])
    simulate(plan, recording=sys.argv[1], progress=say)
"""
"""A run, or the rest of one, in chunks of a second; it says of each frame that it has been simulated."""

KILLS = 6


def test_killed_at_any_moment_it_loses_one_chunk_at_most(tmp_path: Path) -> None:
    """Killed over and over, soon after it has come to some frame of a chunk or other, while files are written."""
    path, moments = tmp_path / "run", random.Random(4)
    losses = []
    for kill in range(KILLS):
        target = recorded_frames(path) + 7 * (kill + 1)
        process = subprocess.Popen([sys.executable, "-c", TELLING, str(path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        said = 0
        while said < target and (word := process.stdout.read(4)):
            said = int.from_bytes(word, "little")
        time.sleep(moments.uniform(0.0, 0.01))
        process.kill()
        rest = process.stdout.read()
        process.wait()
        said = int.from_bytes(rest[-4:], "little") if rest else said
        left = Recording(path)
        if left.status == "done":
            break
        losses.append(said - left.frame_count)
        assert losses[-1] <= left.chunk_frames
    assert len(losses) > 3
    assert max(losses) > 0, "never killed in the middle of a chunk"
    if Recording(path).status == "running":
        subprocess.run([sys.executable, "-c", TELLING, str(path)], stdout=subprocess.DEVNULL, check=True)
    subprocess.run([sys.executable, "-c", TELLING, str(tmp_path / "whole")], stdout=subprocess.DEVNULL, check=True)
    assert same_files(path, tmp_path / "whole")


def test_a_disk_that_takes_no_more(whole: Path, tmp_path: Path) -> None:
    """The system refuses to write more than a few bytes of each file."""

    def refuse(process: subprocess.Popen[str]) -> None:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (4096, 4096))

    path = tmp_path / "run"
    one_line(cut_short(path, refuse), path, "File too large")
    assert not list(path.rglob("*.part"))
    goes_on(path, whole)


def test_a_full_disk(whole: Path, tmp_path: Path) -> None:
    """On a file system of its own that somebody else fills up to the last block."""
    disk = tmp_path / "disk"
    disk.mkdir()
    size = sum(file.stat().st_size for file in whole.rglob("*") if file.is_file())
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={4 * size}", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mount.returncode:
        pytest.skip("may not mount a file system")
    path, ballast = disk / "run", disk / "ballast"

    def fill(process: subprocess.Popen[str]) -> None:
        with open(ballast, "wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(4096))

    try:
        one_line(cut_short(path, fill), path, "No space left on device")
        ballast.unlink()
        goes_on(path, whole)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_directory_that_can_no_longer_be_written(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"

    def without_privilege() -> None:
        # The superuser writes whatever the mode says, unless it gives that up.
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, 0, 0, 0)

    def refuse(process: subprocess.Popen[str]) -> None:
        (path / "velocities").chmod(0o500)

    said = cut_short(path, refuse, without_privilege)
    one_line(said, path, "Permission denied")
    (path / "velocities").chmod(0o755)
    goes_on(path, whole)


# ---- a cold cache ----------------------------------------------------------------------------------------------------
def test_two_runs_at_once_on_one_cold_kernel_cache(tmp_path: Path) -> None:
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "kernels")}
    command = [*COMMAND, "simulate", "straight", "--agents", "5", "--seconds", "1", "--json"]
    # A body that is soon compiled, and a scenario that asks for few kernels beside it.
    command += ["--set", "crowd.character=point-mass", "--set", "crowd.contact=false", "--recording"]
    runs = [
        subprocess.Popen(
            [*command, str(tmp_path / name)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for name in ("one", "other")
    ]
    reports = []
    for process in runs:
        out, said = process.communicate(timeout=400)
        assert process.returncode == 0, said
        reports.append(json.loads(out))
    assert any((tmp_path / "kernels").rglob("*")), "the cache was not where it was to be"
    assert reports[0]["state_hash"] == reports[1]["state_hash"]
    assert same_files(tmp_path / "one", tmp_path / "other")
