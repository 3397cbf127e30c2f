"""The page about a ride: along the profile of its course, in the colours of its riders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from echelon.export.plots import plot_run
from echelon.export.ride_plots import _gaps, _read
from tests.export.road_ride import ride_recording, small_course


def test_page_names_its_panels(tmp_path: Path) -> None:
    page = plot_run(ride_recording(4, 60), tmp_path / "page.svg").read_text()
    for words in ("small-loop", "height", "speed", "power", "behind the first", "offset", "lean to the right", "user"):
        assert words in page, words
    assert "A small ride" in page
    assert "0 off road" in page
    ElementTree.fromstring(page)


def test_page_is_the_same_every_time_and_small_runs_have_one(tmp_path: Path) -> None:
    for suffix in (".png", ".svg"):
        first, second = (plot_run(ride_recording(2, 20), tmp_path / f"{n}{suffix}").read_bytes() for n in "ab")
        assert first == second
    assert plot_run(ride_recording(1, 1, actors=False), tmp_path / "one.png").stat().st_size > 10_000


def test_page_without_measures(tmp_path: Path) -> None:
    run = ride_recording(2, 20)
    bare = replace(run, measures=run.measures[..., :0], measure_names=())
    page = plot_run(bare, tmp_path / "page.svg").read_text()
    assert "behind the first" in page
    assert "power" not in page


def test_distance_goes_on_over_the_start_line() -> None:
    course = small_course()
    run = ride_recording(3, 300, start=course.length - 30.0, speed=9.0)
    ride = _read(run, course.centreline)
    assert np.allclose(np.diff(ride.s, axis=0), 9.0 / 30.0, atol=0.03)
    assert -40.0 < ride.s.min() < -29.0, "who starts just behind the line has not ridden a lap"
    assert 50.0 < ride.s.max() < 62.0
    far = _read(ride_recording(3, 30, start=course.length - 130.0), course.centreline)
    assert far.s.min() > course.length - 140.0
    line = course.centreline
    expected = ((run.link_poses[:, 0, 0, :2] - line.position(ride.s[:, 0])[:, :2]) * line.left(ride.s[:, 0])).sum(
        axis=1
    )
    assert np.allclose(ride.offsets[:, 0], expected, atol=1e-3)


def test_gaps_are_how_long_ago_the_first_one_was_there() -> None:
    times = np.arange(100) / 10.0
    s = np.column_stack([5.0 * times, 5.0 * times - 20.0, 5.0 * times - 2.5])
    gaps = _gaps(times, s)
    assert np.allclose(gaps, [0.0, 4.0, 0.5], atol=1e-6)
    # Whoever takes the lead over has no gap from then on.
    overtaking = np.column_stack([5.0 * times, 6.0 * times - 3.0])
    found = _gaps(times, overtaking)
    assert found[0, 1] == pytest.approx(0.5, abs=0.15)
    assert found[40:, 1].max() < 1e-9
    assert found[-1, 0] == pytest.approx(9.9 - (5.0 * 9.9 + 3.0) / 6.0, abs=0.02)
