"""The longest files first: who gets one last lets the other processes wait for it."""

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of long files first; those of a file keep their order."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))
