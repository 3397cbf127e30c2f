"""Sweeps: what is run, what the table says, what becomes of it when a worker, the user or the folder fails.

Where a worker is to die, `deadly.run_once` takes the place of a simulation (see conftest.py).
"""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import echelon
from echelon import cli
from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.sweeping import ExecutorName, axis_of_text, seeds_of_text, sweep
from echelon.sweeping.executors import start_pool
from echelon.sweeping.folder import csv_text
from echelon.sweeping.plan import axis_of_values, plan_sweep
from echelon.sweeping.statistics import Spread, points_of, telling

SHORT = {"seconds": 0.5, "crowd.count": 3}


def begun(place: Path, seed: int) -> int:
    """How often the run of a seed was begun."""
    return (place / f"begun-{seed}").stat().st_size


# ---- what is run -----------------------------------------------------------------------------------------------------
def test_every_combination_in_order() -> None:
    axes = [axis_of_text("herd.spacing=2,2.5"), axis_of_text("crowd.in_phase=false,true")]
    plan = plan_sweep("herd", axes, (3, 1), ["seconds=2"])
    found = [(*run.parameters.values(), run.seed) for run in plan.runs]
    assert found == [(a, b, seed) for a in (2, 2.5) for b in (False, True) for seed in (3, 1)]
    assert [run.number for run in plan.runs] == list(range(8))
    for run in plan.runs:
        scenario = Scenario.from_dict(run.scenario)
        assert (scenario.herd.spacing, scenario.crowd.in_phase) == tuple(run.parameters.values())
        assert (scenario.seed, scenario.seconds) == (run.seed, 2.0)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("herd.spacing=2,2.5", (2, 2.5)),
        ("herd.mode=herd, constant", ("herd", "constant")),
        ("crowd.start_center=[0,8], [1, 2]", ([0, 8], [1, 2])),
        ("title='a, b',\"c\"", ("a, b", "c")),
        ("crowd.in_phase=true", (True,)),
    ],
)
def test_axes_as_people_write_them(text: str, values: tuple[Any, ...]) -> None:
    axis = axis_of_text(text)
    assert axis.values == values
    again = axis_of_values(axis.key, values)
    assert again.values == values


def test_seeds_as_people_write_them() -> None:
    assert seeds_of_text("1-3") == (1, 2, 3)
    assert seeds_of_text("5, 1-2,9") == (5, 1, 2, 9)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], "needs something that varies"),
        (["--over", "herd.spacing"], "must be key=value,value"),
        (["--over", "herd.spacing=2,,3"], "a value is empty"),
        (["--over", "herd.spacing=2,2"], "the value 2 is given twice"),
        (["--over", "herd.spacing=2", "--over", "herd.spacing=3"], "is given twice"),
        (["--over", "herd.spacng=2,3"], "did you mean 'spacing'"),
        (["--over", "herd.spacing=2,-3"], "herd.spacing = -3"),
        (["--over", "seed=1,2"], "--seeds 1-10"),
        (["--over", "herd.spacing=2,3", "--set", "herd.spacing=1"], "the sweep varies herd.spacing"),
        (["--seeds", "1-3", "--set", "seed=1"], "the sweep varies seed"),
        (["--seeds", "one"], "must be seeds or ranges"),
        (["--seeds", "3-1"], "runs backwards"),
        (["--seeds", "1,1"], "a seed is given twice"),
        (["--seeds", "1-9999999"], "at most 1000000"),
        (["--seeds", "9999999999"], "must be a whole number from 0"),
        (["--seeds", "1-2000", "--over", f"population_seed={','.join(map(str, range(600)))}"], "has 1200000 runs"),
        (["--seeds", "1-2", "--workers", "0"], "--workers"),
        (["--seeds", "1-2", "--threads", "0"], "--threads"),
        (["--seeds", "1-2", "--executor", "slurm"], "--executor"),
        (["--seeds", "1-2", "--executor", "mpi"], "mpi"),
        (["--seeds", "1-2", "--dask-address", "tcp://127.0.0.1:1"], "needs --executor dask"),
        (["--seeds", "1-2", "--set", "nonsense"], "must be key=value"),
        (["--seeds", "1-2", "--out", "no/such"], "there is no folder"),
        (["--seeds", "1-2", "--out", "kept"], "exists and is not a sweep"),
        (["--seeds", "1-2", "--out", "kept/work.txt"], "is a file"),
    ],
    ids=lambda value: " ".join(value)[:60] if isinstance(value, list) else "",
)
def test_wrong_input(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    expected: str,
) -> None:
    """One line, exit code 2, nothing written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "work.txt").write_text("years of it")
    assert cli.run(["sweep", "herd", "--out", "new", *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("echelon: ")
    assert err.count("\n") == 1
    assert expected in err
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == ["kept", "kept/work.txt"]


def test_an_extra_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    extras: tuple[tuple[ExecutorName, str], ...] = (("mpi", "mpi4py.futures"), ("dask", "distributed"))
    for name, module in extras:
        monkeypatch.setitem(sys.modules, module, None)
        with (
            pytest.raises(InputError, match=rf"^--executor {name}: .*`pip install 'echelon\[{name}\]'` adds it$"),
            start_pool(name, 2),
        ):
            pass


# ---- the table -------------------------------------------------------------------------------------------------------
def test_the_table_is_that_of_the_runs_one_by_one(tmp_path: Path) -> None:
    result = echelon.sweep(
        "herd", over={"herd.spacing": [2.0, 3.0]}, seeds=[4, 2], settings=SHORT, out=tmp_path / "sweep", workers=2
    )
    assert result is not None
    assert (result.ran, result.failed, result.keys) == (4, (), ("herd.spacing",))
    assert [(row["parameters"]["herd.spacing"], row["seed"]) for row in result.rows] == [(2, 4), (2, 2), (3, 4), (3, 2)]
    alone = echelon.simulate("herd", seed=2, settings=SHORT | {"herd.spacing": 3.0})
    assert result.rows[3]["summary"] == json.loads(json.dumps(alone.summary))
    with open(result.csv, newline="") as lines:
        table = list(csv.DictReader(lines))
    assert [row["state_hash"] for row in table] == [row["summary"]["state_hash"] for row in result.rows]
    assert len({row["state_hash"] for row in table}) == 4
    assert table[3]["frames"] == "16"
    assert [json.loads(line) for line in (tmp_path / "sweep" / "table.jsonl").open()] == list(result.rows)
    assert not (tmp_path / "sweep" / "recordings").exists()


def test_kept_recordings(tmp_path: Path) -> None:
    result = sweep("herd", seeds=[5], settings=SHORT, out=tmp_path / "sweep", workers=1, keep_recordings=True)
    assert result is not None
    kept = echelon.open_recording(tmp_path / "sweep" / "recordings" / "0000000")
    assert (kept.status, kept.scenario["seed"]) == ("done", 5)
    assert kept.summary["state_hash"] == result.rows[0]["summary"]["state_hash"]


def test_csv_holds_what_is_flat_and_points_what_is_a_number() -> None:
    def row(number: int, spacing: float, status: str, summary: dict[str, Any], why: str = "") -> dict[str, Any]:
        parameters = {"herd.spacing": spacing, "crowd.start_center": [0, number]}
        return {
            "run": number, "parameters": parameters, "seed": number + 1, "status": status, "why": why,
            "summary": summary,
        }  # fmt: skip

    rows = [
        row(0, 2.0, "done", {"falls": 1, "penned": True, "since": None, "riders": [1], "hash": "ab"}),
        row(1, 2.0, "failed", {}, "it broke, badly"),
        row(2, 2.0, "waiting", {}),
    ]
    assert csv_text(rows, ("herd.spacing", "crowd.start_center")).splitlines() == [
        "run,herd.spacing,crowd.start_center,seed,status,falls,penned,since,hash,why",
        '0,2.0,"[0, 0]",1,done,1,true,,ab,',
        '1,2.0,"[0, 1]",2,failed,,,,,"it broke, badly"',
        '2,2.0,"[0, 2]",3,waiting,,,,,',
    ]
    for entry in rows:
        entry["parameters"] = {"herd.spacing": 2.0}
    rows[2] |= {"status": "done", "summary": {"falls": 4, "penned": True}}
    (point,) = points_of(rows)
    assert (point.runs, point.done) == (3, 2)
    assert point.numbers == {"falls": Spread(2.5, 1, 4), "penned": Spread(1, 1, 1)}
    assert telling([point]) == ("falls",)


# ---- going on --------------------------------------------------------------------------------------------------------
def test_goes_on_where_it_stopped(tmp_path: Path, deadly: ModuleType) -> None:
    place = tmp_path / "sweep"
    first = sweep("herd", seeds=range(1, 6), out=place, workers=2)
    assert first is not None
    assert first.ran == 5
    whole = first.csv.read_bytes()
    for number in (1, 3):
        (place / "rows" / f"{number:07d}.json").unlink()
    again = sweep("herd", seeds=range(1, 6), out=place, workers=1)
    assert again is not None
    assert again.ran == 2
    assert [begun(tmp_path, seed) for seed in range(1, 6)] == [1, 2, 1, 2, 1]
    assert again.csv.read_bytes() == whole
    assert again.rows == first.rows
    assert sorted(path.suffix for path in (place / "rows").iterdir()) == [".json"] * 5


@pytest.mark.parametrize(
    ("options", "difference"),
    [
        ({"seeds": [1, 2, 3]}, r"its seeds is \[1, 2\], not \[1, 2, 3\]"),
        ({"over": {"herd.gain": [1.0]}}, "its over is"),
        ({"settings": {"crowd.count": 9}}, "its scenario differs in crowd"),
        ({"scenario": "straight"}, 'its scenario is "herd", not "straight"'),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_another_sweep_is_refused(tmp_path: Path, deadly: ModuleType, options: dict[str, Any], difference: str) -> None:
    given: dict[str, Any] = {"scenario": "herd", "seeds": [1, 2], "out": tmp_path / "sweep", "workers": 1}
    sweep(**given)
    before = (tmp_path / "sweep" / "table.csv").read_bytes()
    with pytest.raises(InputError, match=difference):
        sweep(**given | options)
    assert (tmp_path / "sweep" / "table.csv").read_bytes() == before


def test_damaged_folders_are_refused(tmp_path: Path, deadly: ModuleType) -> None:
    place = tmp_path / "sweep"
    sweep("herd", seeds=[1], out=place, workers=1)
    (place / "rows" / "0000000.json").write_text("{")
    with pytest.raises(InputError, match=r"0000000\.json: cannot be read as a run's row"):
        sweep("herd", seeds=[1], out=place, workers=1)
    (place / "sweep.json").write_text("[]")
    with pytest.raises(InputError, match=r"sweep\.json: cannot be read as a sweep's"):
        sweep("herd", seeds=[1], out=place, workers=1)


# ---- workers that die ------------------------------------------------------------------------------------------------
def test_a_worker_that_dies_once_costs_nothing(tmp_path: Path, deadly: ModuleType) -> None:
    result = sweep("herd", seeds=range(1, 10), out=tmp_path / "sweep", workers=2)
    assert result is not None
    assert result.failed == ()
    assert [row["summary"]["falls"] for row in result.rows] == list(range(1, 10))
    assert begun(tmp_path, 7) == 2
    assert sum(begun(tmp_path, seed) for seed in range(1, 10)) <= 9 + 2


def test_a_run_that_kills_its_worker_is_marked_and_the_rest_is_done(
    tmp_path: Path, deadly: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["sweep", "herd", "--seeds", "10-15", "--out", "sweep", "--workers", "2"]) == 1
    out, err = capsys.readouterr()
    line = err.splitlines()[-1]
    assert line.startswith("echelon: 2 of 6 runs failed (see sweep/table.csv); run 1: ValueError: eleven")
    assert "4 of 6" in out
    with open("sweep/table.csv", newline="") as lines:
        table = list(csv.DictReader(lines))
    assert [row["status"] for row in table] == ["done", "failed", "done", "failed", "done", "done"]
    assert table[3]["why"] == "its process died 3 times, the last time with nothing else running"
    assert begun(tmp_path, 13) == 3
    assert all(begun(tmp_path, seed) <= 3 for seed in (10, 12, 14, 15))
    # What failed is tried again; what is done is not.
    before = begun(tmp_path, 10)
    assert cli.run(["sweep", "herd", "--seeds", "10-15", "--out", "sweep", "--workers", "2", "--json"]) == 1
    report = json.loads(capsys.readouterr()[0])
    assert (report["runs"], report["ran"], report["failed"]) == (6, 2, 2)
    assert (begun(tmp_path, 10), begun(tmp_path, 11), begun(tmp_path, 13)) == (before, 2, 6)
    assert report["points"][0]["numbers"]["falls"] == {"mean": 12.75, "min": 10.0, "max": 15.0}


def test_deaths_are_remembered_when_everything_dies_at_once(tmp_path: Path, deadly: ModuleType) -> None:
    """As under MPI, which ends the whole job: the run that was under way is not begun for ever and ever."""
    place = tmp_path / "sweep"
    sweep("herd", seeds=[1, 2], out=place, workers=1)
    (place / "rows" / "0000001.json").unlink()
    (place / "rows" / "0000001.begun").write_text("3")
    result = sweep("herd", seeds=[1, 2], out=place, workers=1)
    assert result is not None
    assert [row["status"] for row in result.rows] == ["done", "failed"]
    assert begun(tmp_path, 2) == 1
    assert not (place / "rows" / "0000001.begun").exists()


# ---- interruptions ---------------------------------------------------------------------------------------------------
def test_an_interruption_leaves_a_table_to_go_on_with(tmp_path: Path, deadly: ModuleType) -> None:
    def interrupt(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    place = tmp_path / "sweep"
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        sweep("herd", seeds=[1, 2, 101, 102], out=place, workers=2, progress=interrupt)
    assert time.monotonic() - start < 20.0  # the runs under way take longer
    with open(place / "table.csv", newline="") as lines:
        assert [row["status"] for row in csv.DictReader(lines)] == ["done", "done", "waiting", "waiting"]
    assert not list((place / "rows").glob("*.begun"))


def test_ctrl_c_on_the_command(tmp_path: Path) -> None:
    """Given to all processes, as a terminal does: one line, and nobody is left behind."""
    command = [sys.executable, "-c", "from echelon.cli import main; main()", "sweep", "herd", "--seeds", "1-50"]
    command += ["--set", "seconds=60", "--workers", "2", "--out", "sweep", "--quiet"]

    def heed() -> None:
        # A shell that runs the tests in the background lets its children ignore what Ctrl-C sends.
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    process = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=heed
    )
    deadline = time.monotonic() + 120.0
    while not list((tmp_path / "sweep" / "rows").glob("*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30.0)
    assert (process.returncode, err) == (1, "echelon: interrupted; the same command goes on with sweep\n")
    with open(tmp_path / "sweep" / "table.csv", newline="") as lines:
        table = list(csv.DictReader(lines))
    assert {row["status"] for row in table} == {"done", "waiting"}
    deadline = time.monotonic() + 5.0
    while somebody_lives(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not somebody_lives(process.pid)


def somebody_lives(group: int) -> bool:
    """Whether there is a process in a group."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
