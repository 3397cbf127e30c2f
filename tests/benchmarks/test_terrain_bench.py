"""`echelon bench terrain`: rates of the right ground, and none of a wrong one."""

from __future__ import annotations

import io
import json

import pytest
from rich.console import Console

from echelon.benchmarks import terrain
from echelon.benchmarks.terrain import print_table, run_terrain_benchmark
from echelon.errors import InputError

COURSE = """\
name = "hillock"
title = "A short way over a hillock"
closed = false
width = 6.0
points = [[0.0, 0.0, 0.0], [60.0, 5.0, 1.5], [120.0, 0.0, 4.0], [180.0, -10.0, 2.0], [240.0, 0.0, 0.0]]
"""


@pytest.fixture
def course(tmp_path) -> str:
    path = tmp_path / "hillock.toml"
    path.write_text(COURSE, encoding="utf-8")
    return str(path)


def test_the_ground_of_a_course_is_right_and_has_rates(course: str):
    seen: list[tuple[int, int]] = []
    rows = run_terrain_benchmark(course=course, queries=20_000, progress=lambda done, total: seen.append((done, total)))
    assert (seen[0], seen[-1]) == ((0, 3), (3, 3))
    assert [row["where"] for row in rows] == ["riding", "road, at random", "land, at random"]
    for row in rows:
        assert row["sane"], row["why"]
        # Far from what is promised, since other work may be going on.
        assert row["queries_per_second"] > 1e5
        assert row["query_ns"] == pytest.approx(1e9 / row["queries_per_second"])
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    console = Console(width=80, file=io.StringIO())
    print_table(rows, console)
    table = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue] (it is the StringIO)
    assert f"{1e-6 * rows[0]['queries_per_second']:.2f}" in table
    assert f"{rows[0]['triangles']:,} triangles" in table


def test_wrong_ground_has_no_rate(course: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(terrain, "ROAD_TOLERANCE", 1e-9)
    rows = run_terrain_benchmark(course=course, queries=1000)
    for row in rows:
        assert not row["sane"]
        assert row["queries_per_second"] is None
        assert "more than" in row["why"]
    print_table(rows, Console(file=io.StringIO()))


def test_an_unknown_course_is_bad_input():
    with pytest.raises(InputError, match="no-such-course"):
        run_terrain_benchmark(course="no-such-course")
