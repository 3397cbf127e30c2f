"""The engine's benchmark, on few agents: what its rows say, and that it gives no rate for what is not sane."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import pytest
from rich.console import Console

from echelon.agents.hopper import HIP_SPEED, Hopper
from echelon.benchmarks import engine
from echelon.benchmarks.csv_rows import read_csv, write_csv
from echelon.benchmarks.engine import engine_row, ladders_of, run_engine_benchmark
from echelon.benchmarks.engine_report import page, print_table, write_page
from echelon.benchmarks.engine_runs import character_of, stride_of
from echelon.errors import InputError
from echelon.warp_kernels.character import View
from echelon.warp_kernels.contact import JointForces

KEYS = {
    *("body", "integrator", "step_seconds", "lanes", "threads", "contacts", "substep_us", "real_time_factor"),
    *("peer", "peer_step_us", "ratio"),  # those are the interface; what follows states the conditions
    *("measure", "precision", "agents", "actions", "operations", "sane", "why", "compile_seconds", "load_seconds"),
    *("peer_integrator", "peer_precision", "peer_step_seconds", "peer_contacts", "peer_sane", "peer_why"),
    *("machine", "versions"),
}


class ShovedHopper(Hopper):
    """A hopper with a motor that got stuck: a constant torque about the first axis of its hip [N m]."""

    name = "shoved-hopper"

    def __init__(self, torque: float) -> None:
        super().__init__()
        # A parameter, so that one compilation serves every torque.
        self.parameters: Mapping[str, float] = {**Hopper.parameters, "stuck_torque": torque}

    def actuate(self, view: View, joints: JointForces) -> None:
        super().actuate(view, joints)
        joints.tau[HIP_SPEED] = joints.tau[HIP_SPEED] + view.parameters["stuck_torque"]


@cache
def quick_rows() -> tuple[dict[str, Any], ...]:
    pytest.importorskip("mujoco")
    return tuple(run_engine_benchmark(bodies=("hopper",), quick=True))


def broken_row(torque: float) -> dict[str, Any]:
    return engine_row("hopper", ShovedHopper(torque), agents=8, rounds=2, peers=())


def printed(rows: list[dict[str, Any]]) -> str:
    console = Console(width=80, file=io.StringIO())
    print_table(rows, console)
    return console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue] (it is the StringIO)


def test_a_quick_run_states_everything():
    (row,) = quick_rows()
    assert set(row) >= KEYS
    assert row["body"] == "hopper"
    assert row["integrator"] == "semi-implicit"
    assert row["threads"] == 1
    assert row["contacts"] == 3
    assert row["peer_contacts"] == 2
    assert row["peer"].startswith("MuJoCo ")
    assert row["sane"]
    assert row["peer_sane"]
    assert row["step_seconds"] == row["peer_step_seconds"]
    assert row["ratio"] == pytest.approx(row["peer_step_us"] / row["substep_us"])
    assert row["real_time_factor"] == pytest.approx(row["step_seconds"] / row["substep_us"] * 1e6)
    # Far from what is promised, since other work may be going on: even so hundreds of times between these.
    assert 0.001 < row["substep_us"] < 5.0
    assert row["ratio"] > 5.0


def test_the_cyclist_is_timed_on_a_road_beside_a_rider_of_mujocos():
    pytest.importorskip("mujoco")
    (row,) = run_engine_benchmark(bodies=("cyclist",), quick=True)
    assert set(row) >= KEYS
    assert row["sane"], row["why"]
    assert row["peer_sane"], row["peer_why"]
    assert row["peer_contacts"] == 2
    assert row["step_seconds"] == row["peer_step_seconds"] == pytest.approx(1.0 / 900.0)
    assert "rolling unsteered" in row["actions"]
    assert row["ratio"] > 5.0


def test_rows_are_plain_data():
    rows = list(quick_rows())
    again = json.loads(json.dumps(rows, allow_nan=False))
    assert again == rows


def test_progress_ends_at_the_end():
    pytest.importorskip("mujoco")
    seen: list[tuple[int, int]] = []
    run_engine_benchmark(bodies=("hopper",), quick=True, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, 1)
    assert seen[-1] == (1, 1)


@pytest.mark.parametrize(("torque", "reason"), [(200.0, "agents fell"), (3e38, "stopped being finite")])
def test_a_run_that_is_not_sane_has_no_rate(torque: float, reason: str):
    row = broken_row(torque)
    assert not row["sane"]
    assert reason in row["why"]
    assert row["substep_us"] is None
    assert row["real_time_factor"] is None
    assert row["ratio"] is None
    json.dumps(row, allow_nan=False)
    table = " ".join(printed([row]).split())
    assert "no rate, since" in table
    assert reason in table


def test_a_sane_character_in_the_same_harness_has_a_rate():
    """The refusal is not for everybody: the stuck motor at zero hops."""
    row = engine_row("hopper", ShovedHopper(0.0), agents=9, rounds=10, peers=())
    assert row["sane"], row["why"]
    assert row["substep_us"] > 0.0


def test_without_mujoco_there_are_our_rates_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    (row,) = run_engine_benchmark(bodies=("hopper",), quick=True)
    assert row["substep_us"] > 0.0
    assert row["peer"] is None
    assert row["peer_step_us"] is None
    assert row["ratio"] is None
    lines = [line for line in printed([row]).splitlines() if "echelon[bench]" in line]
    assert len(lines) == 1
    assert lines[0].startswith("MuJoCo is not installed")


def test_steps_of_a_ladder_grow_and_keep_the_control_ticks():
    for body in ("hopper", "cyclist", "male"):
        character = character_of(body)
        ours, theirs = ladders_of(character)
        assert ours[0] == stride_of(character)
        assert [stride.step for stride in ours] == sorted(stride.step for stride in ours)
        assert list(theirs) == sorted(set(theirs))
        if body != "male":
            tick = ours[0].tick * ours[0].step
            assert [stride.tick * stride.step for stride in ours] == pytest.approx([tick] * len(ours))
            assert max(theirs) <= tick


def test_an_unknown_body_is_bad_input():
    with pytest.raises(InputError, match="hoper"):
        run_engine_benchmark(bodies=("hoper",), quick=True)


def test_the_table_has_units_and_says_where_it_was_measured():
    (row,) = quick_rows()
    table = printed([row])
    assert "µs" in table
    assert "[ms]" in table
    for value in (f"{row['substep_us']:.4f}", f"{row['peer_step_us']:.2f}", f"{row['ratio']:,.1f}", "semi-implicit"):
        assert value in table
    flat = " ".join(table.split())
    assert row["machine"] in flat
    assert row["versions"] in flat
    assert f"{row['lanes']} lanes of float32" in flat


def test_files_give_back_what_was_written(tmp_path):
    rows = [*quick_rows(), broken_row(200.0)]
    write_csv(rows, tmp_path / "some-machine" / "engine.csv")
    again = read_csv(tmp_path / "some-machine" / "engine.csv")
    for row, found in zip(rows, again, strict=True):
        assert row.keys() == found.keys()
        for key, value in row.items():
            if isinstance(value, float):
                assert math.isclose(found[key], value, rel_tol=1e-5), key
            else:
                assert found[key] == value, key
    path = write_page(tmp_path)
    text = path.read_text(encoding="utf-8")
    assert text == page(tmp_path)
    assert "## some-machine" in text
    assert "agents fell" in text
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["engine.md", "some-machine"]
