"""The group tests in short: what a person would see go right or wrong, and that the benchmark says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from echelon.benchmarks.csv_rows import read_csv
from echelon.benchmarks.group_plots import write_paths
from echelon.benchmarks.group_problems import GROUPS, ORCA, PAPER, PROBLEMS, Group, GroupTest, chosen_tests
from echelon.benchmarks.group_run import Track, outcome, recovery_time, track
from echelon.benchmarks.groups import run_groups_benchmark, write_files
from echelon.benchmarks.groups_report import markdown
from echelon.benchmarks.orca import PACKAGE, OrcaPlanner, orca_version
from echelon.cli.commands import app
from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.simulation.loop import Simulation

needs_orca = pytest.mark.skipif(not orca_version(), reason=f"ORCA's package {PACKAGE} is not installed")

HOPPERS, PUCKS, RIDERS = Group("hopper", 16), Group("point-mass", 16), GROUPS[-1]


def run(group: Group, problem: str, law: str, seconds: float, seed: int = 1) -> Track:
    """A test, cut short."""
    scenario = replace(GroupTest(group, problem, law).scenario(seed), seconds=seconds)
    planner = OrcaPlanner(scenario) if law == ORCA else None
    return track(Simulation(scenario, threads=1), planner)


def standing_still(scenario: Scenario, velocities: np.ndarray) -> Track:
    """A run whose agents have these velocities, shape [frames, agents, 2], and stay where they are."""
    places = np.zeros_like(velocities)
    places[..., 0] = 3.0 * np.arange(velocities.shape[1])
    return Track(
        scenario, places, velocities, np.zeros(velocities.shape[:2], dtype=bool), np.zeros(velocities.shape[1]), 0
    )


# ---- what a person would see ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("group", [PUCKS, HOPPERS, RIDERS], ids=lambda group: group.name)
def test_a_group_in_steady_state_keeps_its_shape_and_speed(group: Group) -> None:
    found = outcome(run(group, "steady", group.law, 8.0))
    assert found.clean
    assert 0.8 < found.dispersion < 1.1
    assert found.off_speed < 0.15
    assert found.nearest > 1.2


@pytest.mark.parametrize("group", [PUCKS, HOPPERS, RIDERS], ids=lambda group: group.name)
def test_a_group_turns_without_falls_and_recovers(group: Group) -> None:
    found = outcome(run(group, "turning", group.law, 15.0))
    assert found.clean
    assert found.recovery < 6.0
    assert 0.8 < found.dispersion < 1.1


def test_robots_pass_a_gap_between_its_posts() -> None:
    seen = run(HOPPERS, "gap", "approach", 36.0)
    found = outcome(seen)
    assert (found.falls, found.passed, found.lost) == (0, 16, 0)
    crossing = np.argmax(seen.positions[..., 0] > 20.0, axis=0)
    sides = np.abs(seen.positions[crossing, np.arange(16), 1])
    assert sides.max() < 3.0 - 0.3, "everybody went through the opening, a body's radius from its posts"


def test_riders_thread_through_columns() -> None:
    seen = run(RIDERS, "columns", "foresight", 22.0)
    found = outcome(seen)
    assert found.clean
    assert found.passed == 18
    gaps = seen.positions[:, :, None] - seen.scenario.world.all_columns()[:, :2]
    assert np.linalg.norm(gaps, axis=-1).min() > 1.0, "nobody came near a column of 0.6 m"


def test_what_dynamics_cost_the_published_law() -> None:
    """Where many must pass a gap, the published law lets robots run into each other; ours does not."""
    group = Group("hopper", 50)
    paper, ours = (outcome(run(group, "gap", law, 30.0)) for law in (PAPER, "approach"))
    assert paper.collisions > 5
    assert ours.collisions == 0


@needs_orca
def test_orca_leads_point_masses_and_loses_robots() -> None:
    pucks, robots = (outcome(run(Group(name, 50), "gap", ORCA, 40.0)) for name in ("point-mass", "hopper"))
    assert pucks.collisions == 0
    assert pucks.passed > 40
    assert robots.collisions > 20


# ---- what is measured ------------------------------------------------------------------------------------------------
def test_recovery_counts_from_the_turn_until_the_last_has_the_new_velocity() -> None:
    scenario = GroupTest(HOPPERS, "turning", "approach").scenario(1)
    frames = round(20.0 * scenario.frame_rate)
    velocities = np.zeros((frames, 3, 2))
    velocities[..., 0] = 1.0
    for agent, later in enumerate((0.5, 1.0, 4.0)):
        since = round((8.0 + later) * scenario.frame_rate)
        velocities[since:, agent] = (0.0, 1.0)
    assert recovery_time(standing_still(scenario, velocities)) == pytest.approx(4.0, abs=0.5)
    velocities[-5:, 1] = (1.0, 0.0)  # one turns back at the very end
    assert np.isnan(recovery_time(standing_still(scenario, velocities)))


def test_who_falls_or_goes_through_another_is_lost() -> None:
    scenario = GroupTest(HOPPERS, "steady", "approach").scenario(1)
    seen = standing_still(scenario, np.ones((200, 4, 2)))
    seen.fallen[150:, 0] = True
    found = outcome(replace(seen, crossings=np.array([0.0, 0.2, 0.04, 0.0])))
    assert (found.falls, found.crossed, found.lost, found.passed) == (1, 1, 2, 3)
    assert not found.clean


# ---- the benchmark ---------------------------------------------------------------------------------------------------
def test_words_choose_rows() -> None:
    assert len(chosen_tests()) == len(GROUPS) * len(PROBLEMS) * 3
    chosen = chosen_tests(["hopper", "gap", ORCA])
    assert [test.name for test in chosen] == [f"hopper-{count}/gap/orca" for count in (16, 50, 105)]
    with pytest.raises(InputError, match=r"--only gaps: .*did you mean 'gap'"):
        chosen_tests(["gaps"])


def test_every_test_is_a_scenario_that_ships() -> None:
    for test in chosen_tests():
        scenario = test.scenario(3)
        assert (scenario.seed, scenario.crowd.count) == (3, test.group.count)
        assert scenario.crowd.character == test.group.character


def test_rows_become_a_table_a_file_and_plots(tmp_path: Path) -> None:
    short = [test for test in chosen_tests(["hopper-16", "steady"]) if test.law != ORCA]
    rows = run_groups_benchmark(seeds=2, chosen=short)
    assert [row["law"] for row in rows] == [PAPER, "approach"]
    assert all(row["clean"] == row["seeds"] == 2 for row in rows)
    table, picture = write_files(rows, tmp_path / "found")
    assert [row["law"] for row in read_csv(table)] == [PAPER, "approach"]
    assert picture.stat().st_size < 300_000
    assert "2 of 2" in markdown(read_csv(table))
    ways = write_paths([("gap", run(PUCKS, "gap", "approach", 2.0))], tmp_path / "ways.png")
    assert ways.stat().st_size > 5_000


def test_the_command_says_what_it_does_not_know() -> None:
    result = CliRunner().invoke(app, ["bench", "groups", "--only", "orka"])
    assert isinstance(result.exception, InputError)
    assert "did you mean 'orca'" in str(result.exception)


def test_the_command_prints_rows_as_json() -> None:
    words = ["--only", "point-mass", "--only", "steady", "--only", "approach"]
    result = CliRunner().invoke(app, ["bench", "groups", "--json", "--quiet", "--seeds", "1", *words])
    assert result.exception is None, result.output
    (row,) = json.loads(result.stdout)
    assert (row["character"], row["problem"], row["clean"]) == ("point-mass", "steady", 1)
