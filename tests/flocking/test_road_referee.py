"""The road's referee: bodies against plain sampling, laps, the road's edge, obstacles, the finish."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.flocking.referee import PARTNER_LIMIT
from echelon.scenario.road import ObstacleSettings, PelotonSettings
from tests.flocking.point_cyclists import PelotonRun, rounded, straight

SETTINGS = PelotonSettings()
ROAD = straight()


class Judged(PelotonRun):
    """Riders whose places the test decides, frame by frame."""

    def look(self, places: np.ndarray, headings: np.ndarray, speed: float = 5.0) -> list[tuple[int, int]]:
        self.cyclists.places[:] = places
        self.cyclists.headings[:] = headings
        self.cyclists.speeds[:] = speed
        self.want()
        return self.peloton.referee.collisions()


def outlines(places: np.ndarray, headings: np.ndarray) -> np.ndarray:
    """Points along the middle of each body, from end to end of its straight part, shape [riders, points, 2]."""
    radius = SETTINGS.body_half_width
    along = np.linspace(radius - SETTINGS.body_behind, SETTINGS.body_length - SETTINGS.body_behind - radius, 120)
    ahead = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    return places[:, None] + along[None, :, None] * ahead[:, None]


def overlapping(places: np.ndarray, headings: np.ndarray) -> set[tuple[int, int]]:
    lines = outlines(places, headings)
    found = set()
    for a in range(len(places)):
        for b in range(a + 1, len(places)):
            if np.linalg.norm(places[a] - places[b]) < 4.0:
                gaps = np.linalg.norm(lines[a][:, None] - lines[b][None], axis=2)
                if gaps.min() < 2.0 * SETTINGS.body_half_width:
                    found.add((a, b))
    return found


def test_collisions_are_those_of_capsules_and_reported_when_they_begin() -> None:
    random = np.random.default_rng(8)
    run = Judged(SETTINGS, ROAD, half_width=8.0, count=30)
    places = np.column_stack([random.uniform(50.0, 75.0, 30), random.uniform(-7.0, 7.0, 30)])
    headings = random.uniform(-3.1, 3.1, 30)
    before: set[tuple[int, int]] = set()
    total = 0
    for _ in range(10):
        begun = run.look(places, headings)
        now = overlapping(places, headings)
        assert begun == sorted(now - before)
        total += len(now - before)
        assert run.peloton.referee.totals()["collisions"] == total
        before = now
        places = places + random.normal(0.0, 0.4, (30, 2))
        headings = headings + random.normal(0.0, 0.1, 30)
    assert total > 15


def test_crossing_bodies_overlap_though_no_end_is_near() -> None:
    run = Judged(SETTINGS, ROAD, count=2)
    assert run.look(np.array([[100.0, 0.0], [100.5, -0.5]]), np.array([0.0, np.pi / 2])) == [(0, 1)]


def test_of_many_at_once_all_are_counted_and_the_first_named() -> None:
    run = Judged(SETTINGS, ROAD, count=9)
    run.look(np.column_stack([50.0 + 5.0 * np.arange(9), np.zeros(9)]), np.zeros(9))
    pairs = run.look(np.column_stack([60.0 + 0.01 * np.arange(9), np.zeros(9)]), np.zeros(9))
    assert run.peloton.referee.totals()["collisions"] == 36
    assert [b for a, b in pairs if a == 0] == list(range(1, 1 + PARTNER_LIMIT))


def test_progress_goes_on_over_laps_and_equals_what_was_ridden() -> None:
    path = rounded(40.0, 25.0, 15.0)
    run = PelotonRun(PelotonSettings(columns=1), path, count=2, laps=2)
    assert run.peloton.grid.s[1] < 0.0, "the second row starts behind the line"
    progress = run.watch(2100).progress
    steps = np.diff(progress, axis=0)
    assert steps.min() > 0.0
    assert steps.max() < 14.0 / 30.0
    assert progress[0, 1] < 0.0 < 2.0 * path.length < progress[-1].min()
    for rider, summary in enumerate(run.peloton.summary()):
        assert summary["progress"] == pytest.approx(progress[-1, rider])
        assert summary["laps"] == int(progress[-1, rider] // path.length)
        ridden = summary["distance"]
        assert ridden is not None
        assert ridden == pytest.approx(progress[-1, rider] - progress[0, rider], rel=0.02)
        frame = int(np.argmax(progress[:, rider] >= 2.0 * path.length))
        assert summary["finish_time"] == pytest.approx(frame / 30.0)
    assert run.peloton.referee.totals()["finished"] == 2


def test_a_wheel_beyond_the_edge_is_off_the_road() -> None:
    run = Judged(SETTINGS, ROAD, half_width=4.0, count=1)
    shown = []
    turned = np.arcsin(0.3)  # the front wheel is 0.3 m further out than the rear wheel
    looks = [(0.0, 0.0), (4.1, 0.0), (4.2, 0.0), (3.9, 0.0), (3.8, turned), (3.6, turned), (-3.8, -turned)]
    for offset, heading in looks:
        run.look(np.array([[100.0, offset]]), np.array([heading]))
        shown.append(int(run.peloton.referee.arrays.off_road.numpy()[0]))
    assert shown == [0, 1, 1, 0, 1, 0, 1]
    assert run.peloton.referee.totals()["off_road"] == 3
    assert run.peloton.summary()[0]["off_road"] == 3


def test_running_into_an_obstacle_is_noticed() -> None:
    car = ObstacleSettings("car", 100.0, 2.0)  # 4.4 m by 1.8 m: from 97.8 to 102.2, from 1.1 to 2.9
    run = Judged(SETTINGS, ROAD, obstacles=(car,), count=1)
    front = SETTINGS.body_length - SETTINGS.body_behind
    touching = []
    for x, y in [(90.0, 2.0), (97.75 - front, 2.0), (97.85 - front, 2.0), (100.0, 0.8), (100.0, 0.9), (102.5, 2.0)]:
        run.look(np.array([[x, y]]), np.zeros(1))
        touching.append(int(run.peloton.referee.arrays.struck.numpy()[0]))
    assert touching == [0, 0, 1, 0, 1, 1]
    assert run.peloton.referee.totals()["struck"] == 2
