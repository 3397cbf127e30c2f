"""Real MPI processes: the same bytes for any number of ranks, whoever dies, whoever goes on."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from echelon.recording import Recording, layout
from echelon.scenario import Scenario
from echelon.simulation import simulate

MPIEXEC = shutil.which("mpiexec", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
needs_mpi = pytest.mark.skipif(
    MPIEXEC is None or importlib.util.find_spec("mpi4py") is None,
    reason="no mpiexec or no mpi4py: pip install echelon[mpi]",
)

SHARD, CHUNK_SECONDS = 5, 1
DRIVER = f"""
import os, signal, sys
from echelon.recording import layout
layout.SHARD_AGENTS, layout._CHUNK_SECONDS = {SHARD}, {CHUNK_SECONDS}
from echelon.simulation.loop import Simulation
from echelon.cli import main
advance, fate, frame = Simulation.advance, os.environ.get("FATE", ""), int(os.environ.get("AT_FRAME", 0))
def fated(self, *arguments):
    if fate and self.ranks.rank == 1 and self.frame == frame:
        if fate == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        raise RuntimeError("the sky has fallen")
    advance(self, *arguments)
Simulation.advance = fated
main()
"""

HERD = ("border-collie", ["seconds=3", "crowd.count=13"])
# Uneven parts, a user, and contact between riders who start close together.
RIDE = ("olympic-race", ["seconds=2.5", "crowd.count=13"])
# Two bodies, an engine each; a rank may have some of both.
CASTS = 'performance.casts=[{character="gymnast-male", share=2}, {character="gymnast-female"}]'
TROUPE = ("troupe", ["seconds=2.5", "crowd.count=13", CASTS, 'performance.maneuver=["knee-bend", "stand"]'])


def launch(count: int, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command on so many ranks."""
    assert MPIEXEC is not None
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return subprocess.run(
        [MPIEXEC, "--oversubscribe", "-n", str(count), sys.executable, "-c", DRIVER, *arguments],
        env={**os.environ, **allowed, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def options(plan: tuple[str, list[str]]) -> list[str]:
    return ["simulate", plan[0], *(f"--set={setting}" for setting in plan[1])]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What one process records, by scenario."""
    found: dict[str, Path] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "SHARD_AGENTS", SHARD)
        patch.setattr(layout, "_CHUNK_SECONDS", CHUNK_SECONDS)
        for name, settings in (HERD, RIDE, TROUPE):
            found[name] = tmp_path_factory.mktemp(name) / "alone.recording"
            simulate(Scenario.load(name, settings), recording=found[name], threads=1)
    return found


@needs_mpi
@pytest.mark.parametrize(
    ("plan", "count"),
    [(HERD, 2), (HERD, 3), (HERD, 4), (RIDE, 3), (TROUPE, 3)],
    ids=["herd-2", "herd-3", "herd-4", "ride-3", "troupe-3"],
)
def test_the_bytes_are_those_of_one_process(
    plan: tuple[str, list[str]], count: int, alone: dict[str, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "ranks.recording"
    done = launch(count, *options(plan), "--recording", str(folder), "--json", "--threads", str(1 + count % 2))
    assert done.returncode == 0, done.stderr
    assert f'"ranks": {count}' in done.stdout
    assert done.stdout.count("state_hash") == 1, "one rank speaks for all"
    expected, found = contents(alone[plan[0]]), contents(folder)
    assert [name for name in expected | found if expected.get(name) != found.get(name)] == []
    assert "link_poses/c.1.2.0.0" in found, "several chunks, and shards that begin on several ranks"


@needs_mpi
@pytest.mark.parametrize("fate", ["killed", "raises"])
def test_a_rank_that_dies_stops_all_and_another_number_goes_on(
    fate: str, alone: dict[str, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "ranks.recording"
    done = launch(3, *options(HERD), "--recording", str(folder), FATE=fate, AT_FRAME="80")
    assert done.returncode != 0
    if fate == "killed":
        assert f"signal {signal.SIGKILL.value}" in done.stderr
    else:
        assert "echelon: rank 1: RuntimeError: the sky has fallen; all ranks stop" in done.stderr
    begun = Recording(folder)
    assert begun.status == "running"
    assert begun.frame_count >= 30, "at most the last chunks are lost"
    if fate == "raises":
        return
    done = launch(2, "resume", str(folder))
    assert done.returncode == 0, done.stderr
    expected, found = contents(alone[HERD[0]]), contents(folder)
    assert [name for name in expected | found if expected.get(name) != found.get(name)] == []


@needs_mpi
@pytest.mark.parametrize(
    ("agents", "complaint"),
    [("1", "crowd.count = 1: must be at least the number of ranks, 2"), ("2000", "across a fence")],
)
def test_wrong_input_is_said_once(agents: str, complaint: str, tmp_path: Path) -> None:
    done = launch(2, "simulate", "herd", "--agents", agents, "--recording", str(tmp_path / "ranks.recording"))
    assert done.returncode == 2
    assert done.stderr.count(complaint) == 1
    assert not (tmp_path / "ranks.recording").exists()


def test_without_mpi4py_it_is_said_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "mpi4py").mkdir()
    (tmp_path / "mpi4py" / "__init__.py").write_text("raise ImportError('no library')")
    done = subprocess.run(
        [sys.executable, "-c", "from echelon.cli import main; main()", "simulate", "herd"],
        env={**os.environ, "PYTHONPATH": str(tmp_path), "OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "0"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "echelon: 2 ranks were launched, but mpi4py cannot be imported (no library); install echelon[mpi]\n"
    )


def test_a_sharded_recording_reads_as_one_of_one_shard(alone: dict[str, Path], tmp_path: Path) -> None:
    whole = simulate(Scenario.load(*HERD), recording=tmp_path / "whole.recording")
    sharded = Recording(alone[HERD[0]])
    assert sharded.summary == whole.summary
    for name in ("link_poses", "velocities", "desired_velocities", "phases", "contacts", "in_corral", "actor_poses"):
        np.testing.assert_array_equal(getattr(sharded, name)[:], getattr(whole, name)[:], err_msg=name)
    np.testing.assert_array_equal(sharded.events, whole.events)
    before, after = sharded.state(0), whole.state(0)
    assert before.keys() == after.keys()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
