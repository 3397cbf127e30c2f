"""The papers' grouping goal, against the formula written out, and the user's script."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from echelon.flocking.grouping import NEAREST
from echelon.scenario.road import PelotonSettings, UserSettings
from tests.flocking.point_cyclists import PelotonRun, straight

FREE = PelotonSettings(grouping_limit=10.0, gathering=5.0, eagerness=20.0, slowest=0.0, start_speed=9.0, neighbours=64)


def wanted(
    settings: PelotonSettings, s: np.ndarray, offsets: np.ndarray, user: UserSettings | None = None
) -> tuple[PelotonRun, np.ndarray, np.ndarray]:
    """A run, and the wanted speeds and offsets of riders put at places."""
    run = PelotonRun(settings, straight(), count=len(s), user=user)
    run.put(s, offsets, 9.0)
    run.want()
    riders = run.peloton.riders
    return run, riders.wanted_speed.numpy()[: len(s)].copy(), riders.wanted_offset.numpy()[: len(s)].copy()


def test_the_goal_is_the_mean_of_those_in_sight_weighted_by_nearness() -> None:
    random = np.random.default_rng(4)
    s, offsets = 50.0 + random.uniform(0.0, 120.0, 12), random.uniform(-3.0, 3.0, 12)
    run, speeds, _ = wanted(FREE, s, offsets)
    places = np.column_stack([s, offsets])
    for rider in range(12):
        distances = np.linalg.norm(places - places[rider], axis=1)
        others = (distances > 0.0) & (distances <= FREE.visibility)
        weights = 1.0 / np.maximum(distances[others], float(NEAREST))
        goal = weights @ s[others] / weights.sum()
        expected = run.peloton.grid.training_speeds[rider] + FREE.distance_gain * (goal - s[rider])
        assert speeds[rider] == pytest.approx(max(expected, 0.0), abs=1e-3)


def test_the_group_pulls_toward_itself_and_no_harder_than_it_may() -> None:
    settings = PelotonSettings(training_spread=0.0, eagerness=20.0)
    _, speeds, offsets = wanted(settings, np.array([100.0, 160.0]), np.array([1.0, -1.0]))
    np.testing.assert_allclose(speeds, 11.0 + settings.grouping_limit * np.array([1.0, -1.0]), atol=1e-4)
    drawn = offsets - PelotonRun(settings, straight(), count=2).peloton.grid.offsets
    np.testing.assert_array_equal(np.sign(drawn), [-1.0, 1.0])
    assert np.abs(drawn).max() <= settings.gathering + 1e-6


def test_the_rate_of_change_counts_a_hundredth() -> None:
    run = PelotonRun(FREE, straight(), count=2)
    speeds = []
    for faster in (0.0, 2.0):
        run.put(np.array([100.0, 110.0]), np.zeros(2), np.array([9.0, 9.0 + faster]))
        run.want()
        speeds.append(run.peloton.riders.wanted_speed.numpy()[0])
    assert speeds[1] - speeds[0] == pytest.approx(2.0 * FREE.velocity_gain, abs=1e-4)


def test_the_user_counts_however_far_away() -> None:
    user = UserSettings(ahead=400.0)
    _, alone, _ = wanted(FREE, np.array([100.0]), np.zeros(1))
    run, speeds, _ = wanted(FREE, np.array([100.0]), np.zeros(1), user)
    gap = run.peloton.grid.s[-1] - 100.0
    assert speeds[0] - alone[0] == pytest.approx(min(FREE.distance_gain * gap, FREE.grouping_limit), abs=0.05)


def test_on_a_climb_one_waits_as_much_as_on_the_flat() -> None:
    """Who is ahead and cannot ride at the training speed is still held back from what can be ridden."""
    settings = PelotonSettings(training_spread=0.0)
    run = PelotonRun(settings, straight(), count=2)
    run.put(np.array([100.0, 118.0]), np.zeros(2), 4.0)
    run.want()
    wanted_speed = run.peloton.riders.wanted_speed.numpy()
    assert wanted_speed[1] == pytest.approx(4.0 + settings.eagerness - settings.grouping_limit, abs=1e-3)


# ---- the user's script -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("by", ["time", "distance"])
def test_a_script_is_followed_between_its_keys(by: Literal["time", "distance"]) -> None:
    user = UserSettings(by=by, keys=((10.0, 6.0, -1.0), (20.0, 8.0, 1.0)))
    run = PelotonRun(PelotonSettings(), straight(), count=1, user=user)
    riders = run.peloton.riders
    seen: list[tuple[float, float, float]] = []
    for _ in range(900):
        run.advance()
        progress = float(run.peloton.referee.arrays.progress.numpy()[1])
        when = (run.frame - 1) / 30.0 if by == "time" else progress - float(run.peloton.grid.s[1])
        seen.append((when, float(riders.wanted_speed.numpy()[1]), float(riders.wanted_offset.numpy()[1])))
    when, speed, offset = np.array(seen).T
    np.testing.assert_allclose(speed, np.interp(when, [10.0, 20.0], [6.0, 8.0]), atol=2e-3)
    np.testing.assert_allclose(offset, np.interp(when, [10.0, 20.0], [-1.0, 1.0]), atol=2e-3)
    assert riders.speed.numpy()[1] == pytest.approx(8.0, abs=0.05)
    assert riders.offset.numpy()[1] == pytest.approx(1.0, abs=0.1)
