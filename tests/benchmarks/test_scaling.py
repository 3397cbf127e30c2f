"""The scaling benchmark on few agents: what its rows say, that it gives no rate for what is not sane, its files."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from echelon import cli
from echelon.benchmarks import scaling, scaling_run
from echelon.benchmarks.scaling import run_scaling_benchmark, threads_of_text
from echelon.benchmarks.scaling_peers import MUJOCO, PACKAGES, RolloutPeer, Standing, missing, peer_rows
from echelon.benchmarks.scaling_report import compared, growth, page, print_table, write_files, write_page
from echelon.benchmarks.scaling_scenes import SIZES, scene_of, straight_course
from echelon.benchmarks.timed_engine import STRIDE
from echelon.errors import InputError
from echelon.flocking.start_grid import start_grid

KEYS = {
    *("engine", "kind", "agents", "threads", "asked_threads", "scene", "frame_ms", "see_ms", "want_ms", "act_ms"),
    *(
        "record_ms",
        "write_ms",
        "unrecorded_ms",
        "unrecorded_efficiency",
        "agent_us",
        "substep_us",
        "real_time_factor",
        "speedup",
        "efficiency",
    ),
    *("step_seconds", "substeps", "contacts", "precision", "integrator", "lanes", "frames", "peak_memory_mb"),
    *("falls", "collisions", "sane", "why", "machine", "versions"),
}


@pytest.fixture
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short rounds."""
    monkeypatch.setattr(scaling_run, "ROUND_SECONDS", 0.02)
    monkeypatch.setattr(scaling_run, "LONG_SECONDS", 0.05)


def a_row(agents: int = 1000, **changes: Any) -> dict[str, Any]:
    """A row as one would be."""
    phases = {
        "see_ms": 0.4,
        "want_ms": 0.6,
        "act_ms": 3.0,
        "exchange_ms": 0.0,
        "record_ms": 1.0,
        "write_ms": 0.5,
        "unrecorded_ms": 4.2,
    }
    return {
        "engine": "Echelon", "kind": "hoppers", "agents": agents, "threads": 1, "asked_threads": 1, "scene": "a herd",
        "integrator": "semi-implicit", "precision": "float32", "step_seconds": 1 / 720, "substeps": 24,
        "tick_seconds": 1 / 120, "contacts": 3, "lanes": 8, "frames": 60, "frame_ms": 5.0, **phases, "agent_us": 5.0,
        "substep_us": 0.2, "real_time_factor": 6.7, "speedup": 1.0, "efficiency": 1.0, "peak_memory_mb": 300.0,
        "falls": 0, "collisions": 0, "sane": True, "why": "nobody fell", "machine": "a machine", "versions": "Warp 1",
    } | changes  # fmt: skip


# ---- measuring -------------------------------------------------------------------------------------------------------
def test_rows_state_everything(briefly: None) -> None:
    one, two = scaling_run.measure("hoppers", 16, (1, 2), rounds=2)
    assert set(one) >= KEYS
    assert (one["asked_threads"], two["asked_threads"]) == (1, 2)
    assert (one["threads"], two["threads"]) == (1, 1)  # so few are not worth a second thread
    for row in (one, two):
        assert row["sane"], row["why"]
        parts = sum(row[f"{phase}_ms"] for phase in ("see", "want", "act", "exchange", "record"))
        assert row["frame_ms"] == pytest.approx(parts)
        assert row["agent_us"] == pytest.approx(1e3 * row["frame_ms"] / 16)
        assert row["substep_us"] == pytest.approx(row["agent_us"] / 24)
        assert row["step_seconds"] == pytest.approx(STRIDE.step)
        assert 100.0 < row["peak_memory_mb"] < 5000.0
        assert row["see_ms"] > 0.0
        assert row["want_ms"] > 0.0
        assert row["unrecorded_ms"] > 0.0
    assert (one["speedup"], one["efficiency"], one["unrecorded_efficiency"]) == (1.0, 1.0, 1.0)
    # Runs that take one thread anyway are as fast as those with one.
    assert (two["frame_ms"], two["unrecorded_ms"]) == (one["frame_ms"], one["unrecorded_ms"])
    assert (two["speedup"], two["efficiency"], two["unrecorded_efficiency"]) == (1.0, 1.0, 1.0)


def test_riders_too(briefly: None) -> None:
    (row,) = scaling_run.measure("riders", 18, (1,), rounds=1)
    assert row["sane"], row["why"]
    assert row["contacts"] == 11


def test_runs_that_differ_or_fall_have_no_rate() -> None:
    calm = {"state_hash": "a", "falls": 0, "nonfinite": 0}
    assert scaling_run._judged([calm, calm], 100) == (True, "nobody fell")
    assert scaling_run._judged([calm | {"falls": 2}], 100) == (True, "2 of 100 fell")
    assert scaling_run._judged([calm | {"falls": 3}], 100)[1] == "3 of 100 agents fell, more than 2 %"
    assert scaling_run._judged([calm | {"nonfinite": 1}], 100)[1].endswith("stopped being finite")
    assert scaling_run._judged([calm, calm | {"state_hash": "b"}], 100)[1].endswith("different bytes")


def test_scenes_hold_everybody(tmp_path: Path) -> None:
    for agents in SIZES["hoppers"][:4]:
        assert len(scene_of("hoppers", agents, tmp_path).scenario.start_positions()) == agents
    for agents in SIZES["riders"]:
        scene = scene_of("riders", agents, tmp_path)
        peloton = scene.scenario.peloton
        course = straight_course("a", 4000.0, 30.0)
        grid = start_grid(peloton, course.centreline, 15.0, agents, seed=1)
        assert len(np.unique(grid.offsets)) == peloton.columns
        assert f"{peloton.columns} abreast" in scene.described


# ---- other engines ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("engine", PACKAGES)
def test_other_engines_are_sane_or_said_to_be_missing(engine: str) -> None:
    if missing(engine):
        assert "pip install 'echelon[peers]'" in missing(engine)
        pytest.skip(missing(engine))
    rows = peer_rows(engine, agents=4, threads=(1, 2), rounds=1)
    assert [row["threads"] for row in rows] == ([1, 2] if engine == MUJOCO else [1])
    for row in rows:
        assert row["sane"], row["why"]
        assert row["substep_us"] > 0.1
        assert row["agent_seconds_per_second"] == pytest.approx(row["step_seconds"] / row["substep_us"] * 1e6)


def test_rollouts_are_what_single_steps_give() -> None:
    mujoco = pytest.importorskip("mujoco")
    standing = Standing.at(STRIDE.step)
    data = mujoco.MjData(standing.model)
    standing.order.write(data, standing.q, standing.u)
    for _ in range(standing.steps):
        mujoco.mj_step(standing.model, data)
    q, u = RolloutPeer(3, 2, STRIDE.step).watched()
    assert len(q) == standing.steps + 1
    end = standing.order.read(data)
    assert q[-1] == pytest.approx(end[0], abs=1e-12)
    assert u[-1] == pytest.approx(end[1], abs=1e-12)


def test_a_missing_engine_is_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "missing", lambda engine: f"{engine} is not installed")
    monkeypatch.setattr(scaling, "_crowd", lambda kind, agents, threads: [a_row(agents, kind=kind)])
    rows = run_scaling_benchmark(most=50)
    assert [(row["engine"], row["kind"], row["agents"]) for row in rows[:3]] == [
        ("Echelon", "hoppers", 16), ("Echelon", "hoppers", 50), ("Echelon", "riders", 18),
    ]  # fmt: skip
    assert [row["why"] for row in rows[3:]] == [f"{engine} is not installed" for engine in PACKAGES]
    assert printed(rows).count("no rate, since") == len(PACKAGES)


# ---- options ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--most", "5"], "--most 5: must be at least 16"),
        (["--only", "riders", "--most", "17"], "--most 17: must be at least 18"),
        (["--only", "sheep"], "sheep"),
        (["--threads", "many"], "must be numbers of threads"),
        (["--threads", "2000"], "must be from 0"),
        (["--out", "no/such"], "must be the name of a folder"),
    ],
    ids=" ".join,
)
def test_wrong_input(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    expected: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["bench", "scaling", *options]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert expected in err


def test_options_of_scaling_are_refused_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["bench", "terrain", "--most", "5"]) == 2
    assert capsys.readouterr()[1] == "echelon: --most: not for bench terrain\n"


def test_threads_as_people_write_them() -> None:
    assert threads_of_text("1, 2,0") == (1, 2, 0)
    with pytest.raises(InputError):
        threads_of_text("")


def test_a_process_that_fails_says_why() -> None:
    with pytest.raises(RuntimeError, match=r"measuring it failed: .*kind 'sheep': must be one of"):
        scaling._in_a_process("scaling_run", {"kind": "sheep", "agents": 1, "threads": [1]})


# ---- the report ------------------------------------------------------------------------------------------------------
def printed(rows: list[dict[str, Any]]) -> str:
    console = Console(width=80, file=io.StringIO())
    print_table(rows, console)
    return console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue] (it is the StringIO)


def the_rows() -> list[dict[str, Any]]:
    """Rows as a whole measurement has them, the widest numbers among them."""
    sizes = {"hoppers": (16, 1000, 100_000), "riders": (18, 1000)}
    rows = [
        a_row(agents, kind=kind, asked_threads=asked, threads=1 + (asked == 0), agent_us=5.0 + agents / 1e5)
        for kind, found in sizes.items()
        for agents in found
        for asked in (1, 0)
    ]
    rows[4] |= {name: 0.0821 for name in rows[4] if name.endswith("_ms")} | {"agent_us": 0.0821, "want_ms": 0.0098}
    rows[4] |= {"real_time_factor": 0.0123, "peak_memory_mb": 896.0}
    rows[0] |= {"frame_ms": None, "agent_us": None, "substep_us": None, "sane": False, "why": "9 of 16 agents fell"}
    other = {
        "engine": "Newton (Featherstone)", "kind": "hoppers", "agents": 1000, "threads": 1, "scene": "standing",
        "integrator": "semi-implicit, springs explicit", "precision": "float32", "step_seconds": 1 / 1440,
        "contacts": 2, "substep_us": 12.3, "agent_seconds_per_second": 56.4, "peak_memory_mb": 300.0, "sane": True,
        "why": "touches the ground", "machine": "a machine", "versions": "Newton 1",
    }  # fmt: skip
    return [*rows, other]


def test_the_table_fits_a_terminal() -> None:
    text = printed(the_rows())
    assert "…" not in text
    for part in ("100,000", "(Featherstone)", "no rate, since 9 of 16 agents fell", "costs 1.20 times"):
        assert part in text


def test_costs_are_compared_with_those_of_a_thousand() -> None:
    rows = [a_row(1000), a_row(100_000, agent_us=6.0)]
    assert growth(rows) == ["hoppers, 1 thread: one of 100,000 costs 1.20 times what one of 1,000 does."]
    assert growth(rows[:1]) == []
    peers = compared(the_rows())
    assert [(row["engine"], row["agents"]) for row in peers] == [("Echelon", 1000)] * 2 + [
        ("Newton (Featherstone)", 1000)
    ]
    assert peers[0]["agent_seconds_per_second"] == pytest.approx(1e6 / 720 / 0.2)


def test_files_and_page(tmp_path: Path) -> None:
    place = tmp_path / "a-machine"
    rows = json.loads(json.dumps(the_rows()))
    written = write_files(rows, place)
    assert [path.name for path in written] == ["scaling.csv", "scaling-peers.csv", "scaling.png"]
    assert (place / "scaling.csv").read_text().count("\n") == len(rows)  # one is of another engine, one line of keys
    with Image.open(place / "scaling.png") as picture:
        assert picture.mode == "P"
    assert (place / "scaling.png").stat().st_size < 60_000
    text = write_page(tmp_path).read_text()
    assert text == page(tmp_path)
    assert "## a-machine" in text
    assert "| 100,000 | 2 |" in text
    assert "| Newton (Featherstone) | 1 | 0.694 |" in text
    with pytest.raises(InputError, match="cannot be written"):
        write_files(rows, place / "scaling.csv" / "inside")


def test_a_scene_is_a_scenario_like_any_other(tmp_path: Path) -> None:
    scenario = scene_of("hoppers", 16, tmp_path).scenario
    assert replace(scenario, seconds=1.0).step_count == 30
