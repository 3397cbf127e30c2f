"""Sweeps by MPI ranks and by Dask workers, real processes on this machine."""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from echelon.sweeping import sweep

HERE = [sys.executable, "-c", "from echelon.cli import main; main()"]
AS_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}

PROGRAM = """
import deadly
import echelon.sweeping.running
from echelon.cli import main

echelon.sweeping.running.run_once = deadly.run_once
main()
"""


def ranks() -> list[str]:
    """What a command for three ranks begins with; skips where there is no MPI."""
    pytest.importorskip("mpi4py.futures")
    mpiexec = shutil.which("mpiexec", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if mpiexec is None:
        pytest.skip("there is no mpiexec")
    return [mpiexec, "--oversubscribe", "-n", "3"]


def statuses(table: Path) -> list[str]:
    """What became of each run."""
    with open(table, newline="", encoding="utf-8") as lines:
        return [row["status"] for row in csv.DictReader(lines)]


def test_all_executors_make_the_same_table(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    arguments = ["sweep", "herd", "--over", "herd.spacing=2,3", "--seeds", "1-2", "--quiet"]
    arguments += ["--set", "seconds=0.5", "--set", "crowd.count=3"]
    ways = {
        "processes": [*HERE, *arguments, "--workers", "2", "--out", "processes"],
        "mpi": [*ranks(), *HERE, *arguments, "--executor", "mpi", "--out", "mpi"],
        "dask": [*HERE, *arguments, "--executor", "dask", "--workers", "2", "--out", "dask"],
    }
    for command in ways.values():
        done = subprocess.run(
            command, cwd=tmp_path, env=os.environ | AS_ROOT, capture_output=True, text=True, timeout=300, check=False
        )
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    tables = {name: (tmp_path / name / "table.csv").read_bytes() for name in ways}
    assert statuses(tmp_path / "mpi" / "table.csv") == ["done"] * 4
    assert tables["mpi"] == tables["dask"] == tables["processes"]


def test_a_rank_that_dies_ends_the_job_and_the_same_command_goes_on(tmp_path: Path, deadly: ModuleType) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [*ranks(), sys.executable, "program.py", "sweep", "herd", "--seeds", "12-15"]
    command += ["--executor", "mpi", "--out", "sweep", "--quiet"]
    environment = os.environ | AS_ROOT | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ended = []
    while len(ended) < 4 and not (ended and ended[-1].returncode == 1):
        ended.append(
            subprocess.run(
                command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300, check=False
            )
        )
    *killed, last = ended
    assert last.returncode == 1, last.stderr
    assert killed
    assert all(done.returncode != 0 for done in killed)
    assert "1 of 4 runs failed" in last.stderr
    assert "its process died 3 times" in last.stderr
    assert statuses(tmp_path / "sweep" / "table.csv") == ["done", "failed", "done", "done"]


def test_a_dask_cluster_that_is_there_already(tmp_path: Path, deadly: ModuleType) -> None:
    """With a run that kills its workers: it alone is marked as failed."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    place = tmp_path / "sweep"
    # Whoever still wants to talk to a worker that died gives up soon.
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "8s"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1", silence_logs=50
        ) as cluster,
    ):
        result = sweep("herd", seeds=[1, 13, 2], out=place, executor="dask", dask_address=cluster.scheduler_address)
    assert result is not None
    assert [row["status"] for row in result.rows] == ["done", "failed", "done"]
    assert result.rows[1]["why"] == "workers died under it again and again"
