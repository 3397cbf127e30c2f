"""In which order tests run, and which are tried again."""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_ride.py",
    "agents/gymnasts/test_dives.py",
    "play/test_browser.py",
    "simulation/test_faults.py",
    "agents/gymnasts/test_leap.py",
    "test_simulation.py",
    "sweeping/test_executors.py",
    "agents/gymnasts/test_balance.py",
    "test_readme.py",
    "agents/riders/test_cyclist.py",
    "test_ranks.py",
    "simulation/test_fallen.py",
    "benchmarks/test_scaling.py",
    "benchmarks/test_engine_benchmark.py",
    "agents/gymnasts/test_land.py",
    "agents/gymnasts/test_tumble.py",
    "sweeping/test_sweep.py",
)
"""Files that take longest, the longest first; every other comes after them in the order of names.

Files that compile the same programs stand apart: two processes that come to them at once would both compile.
"""

BESIDE_OTHERS = (
    "play/test_browser.py",
    "play/test_saved_page.py",
    "play/test_page.py",
    "play/test_front.py",
    "play/test_view.py",
    "play/test_cameras.py",
    "play/test_pitch.py",
    "play/test_trainer.py",
    "flocking/test_group.py::test_a_frame_of_a_hundred_agents_costs_less_than_they_do",
    "flocking/test_peloton.py::test_a_frame_of_sixteen_riders_costs_little",
    "warp_kernels/test_neighbours.py::test_cost_is_linear_in_agents",
    "simulation/test_faults.py::test_killed_it_loses_no_chunk_that_was_recorded",
    "simulation/test_faults.py::test_killed_at_any_moment_it_loses_one_chunk_at_most",
    "simulation/test_faults.py::test_a_disk_that_takes_no_more",
    "simulation/test_faults.py::test_a_full_disk",
    "simulation/test_faults.py::test_a_directory_that_can_no_longer_be_written",
    "test_cli.py::test_a_real_run_killed_and_resumed",
    "sweeping/test_executors.py",
    "sweeping/test_sweep.py::test_ctrl_c_on_the_command",
)
"""Tests that live by the clock, with programs beside them: browsers, servers, clients, clusters, stop watches, and runs
that something must happen to before they end.

A machine that is taken away for a moment, or a browser that stops drawing, fails one of them and tells nothing of what
is tested; so each may be tried three times. All other tests are tried once: a simulation that comes out differently is
a fault. The end of the output says what was tried again, and why.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of long files first, where those of a file keep their order, and say which are tried again."""
    here = Path(__file__).parent
    places = {here / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))
    for item in items:
        file = item.path.relative_to(here).as_posix()
        if file in BESIDE_OTHERS or f"{file}::{item.name}" in BESIDE_OTHERS:
            item.add_marker(pytest.mark.flaky(reruns=2))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what was tried again, and why: what passes in the end should not have to be."""
    for report in terminalreporter.stats.get("rerun", []):
        reason = next((line[2:].strip() for line in report.longreprtext.splitlines() if line.startswith("E ")), "")
        terminalreporter.write_line(f"tried again: {report.nodeid} ({report.when}): {reason}")
