"""The start grid: rows on the road, nobody upon anybody, the same for everybody whatever comes behind."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.flocking.start_grid import START_MARGIN, start_grid
from echelon.scenario.road import PelotonSettings, UserSettings
from tests.flocking.point_cyclists import rounded, straight

SETTINGS = PelotonSettings()
LOOP = rounded(150.0, 60.0, 14.0, hills=5.0)


def test_rows_stand_across_the_road_behind_the_start() -> None:
    grid = start_grid(SETTINGS, LOOP, 4.0, 10, seed=1)
    np.testing.assert_allclose(grid.s, -3.2 * np.repeat([0, 1, 2], [4, 4, 2]))
    np.testing.assert_allclose(grid.offsets[:4], [-1.8, -0.6, 0.6, 1.8])
    s, offsets = LOOP.closest(grid.positions[:, :2])
    np.testing.assert_allclose(s, np.mod(grid.s, LOOP.length), atol=1e-4)
    np.testing.assert_allclose(offsets, grid.offsets, atol=1e-6)
    np.testing.assert_allclose(grid.positions[:, 2], LOOP.position(grid.s)[:, 2])
    tangents = LOOP.tangent(grid.s)
    ahead = np.stack([np.cos(grid.headings), np.sin(grid.headings)], axis=1)
    np.testing.assert_allclose(ahead, tangents[:, :2] / np.hypot(*tangents[:, :2].T)[:, None], atol=1e-9)


def test_a_narrow_road_has_fewer_columns() -> None:
    assert len(np.unique(start_grid(SETTINGS, LOOP, 2.0, 8, seed=1).offsets)) == 2
    np.testing.assert_allclose(start_grid(SETTINGS, LOOP, 1.0, 3, seed=1).offsets, 0.0)


def test_on_an_open_road_everybody_starts_on_it() -> None:
    grid = start_grid(SETTINGS, straight(), 4.0, 16, seed=1)
    assert grid.s.min() == pytest.approx(START_MARGIN)
    far = start_grid(PelotonSettings(start_distance=500.0), straight(), 4.0, 16, seed=1)
    assert far.s.max() == pytest.approx(500.0)


def test_training_speeds_differ_and_do_not_depend_on_the_count() -> None:
    few, many = (start_grid(SETTINGS, LOOP, 4.0, count, seed=7).training_speeds for count in (8, 80))
    np.testing.assert_array_equal(few, many[:8])
    assert abs(many - SETTINGS.training_speed).max() <= SETTINGS.training_spread
    assert many.std() > 0.4 * SETTINGS.training_spread
    assert (start_grid(SETTINGS, LOOP, 4.0, 8, seed=8).training_speeds != few).all()


AMONG_THEM = UserSettings(ahead=0.0, keys=((0.0, 9.0, 0.5),))


@pytest.mark.parametrize(
    ("settings", "user", "length", "message"),
    [
        (SETTINGS, AMONG_THEM, 1500.0, r"user\.ahead = 0: .* where rider 2 does"),
        (SETTINGS, UserSettings(ahead=-30.0), 1500.0, r"user\.ahead = -30: .* off the road"),
        (PelotonSettings(start_distance=300.0), None, 100.0, r"peloton\.start_distance = 300: .* does not fit"),
        (PelotonSettings(edge_margin=4.5), None, 1500.0, r"peloton\.edge_margin = 4\.5: must be at most half"),
    ],
)
def test_starts_that_cannot_be_are_refused(
    settings: PelotonSettings, user: UserSettings | None, length: float, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        start_grid(settings, straight(length), 4.0, 16, seed=1, user=user)
