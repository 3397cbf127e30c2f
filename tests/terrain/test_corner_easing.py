"""Tight corners and turns on the spot as ways that a bicycle can ride."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.terrain.corner_easing import bending, eased
from echelon.terrain.track_smoothing import meetings, smoothed


def corner(angle: float, length: float = 60.0, step: float = 1.0) -> np.ndarray:
    """Two straights that meet at the origin, the second turned to the left by an angle [rad]."""
    along = np.arange(step, length, step)
    before = np.column_stack([-along[::-1], np.zeros_like(along)])
    return np.vstack([before, [[0.0, 0.0]], along[:, None] * np.array([np.cos(angle), np.sin(angle)])])


@pytest.mark.parametrize("degrees", [-170, -90, -60, 45, 90, 120, 150, 175, 180])
def test_a_corner_becomes_rideable_and_its_ends_stay(degrees: float) -> None:
    line = corner(np.radians(degrees))
    result = eased(line, 1.0, 6.0, closed=False)
    assert bending(result.places, closed=False).max() <= 1.0 / 6.0 + 1e-9
    assert result.corners >= 1
    assert result.places[[0, -1]] == pytest.approx(line[[0, -1]])
    # An arc in a street corner; the bulb of a turn on the spot stays within two radii.
    limit = 6.48 * (1.0 / np.cos(np.radians(degrees) / 2.0) - 1.0) + 1.2 if abs(degrees) <= 90 else 13.0
    assert result.moved < limit
    assert np.diff(result.source).min() > 0.0
    assert not result.fresh[[0, -1]].any()


def test_what_is_wide_enough_is_left_alone() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    circle = 30.0 * np.stack([np.cos(t), np.sin(t)], axis=1)
    result = eased(circle, 0.94, 6.0, closed=True)
    assert result.corners == 0
    assert (result.places == circle).all()


def test_a_corner_at_the_seam_of_a_closed_line_is_eased() -> None:
    side = np.arange(0.0, 40.0, 1.0)
    zero, forty = np.zeros_like(side), np.full_like(side, 40.0)
    square = np.vstack([
        np.column_stack(sides) for sides in ((side, zero), (forty, side), (40.0 - side, forty), (zero, 40.0 - side))
    ])  # fmt: skip
    result = eased(square, 1.0, 6.0, closed=True)
    assert result.corners == 4
    assert bending(result.places, closed=True).max() <= 1.0 / 6.0 + 1e-9


def test_a_corner_at_the_end_of_an_open_line_is_named() -> None:
    line = np.vstack([corner(np.pi / 2.0)[:61], [[0.0, 1.0], [0.0, 2.0]]])
    with pytest.raises(InputError, match="too near to an end"):
        eased(line, 1.0, 6.0, closed=False)


# ---- smoothing -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("closed", [True, False])
def test_smoothing_holds_its_bound_and_takes_noise_away(closed: bool) -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    circle = 60.0 * np.stack([np.cos(t), np.sin(t)], axis=1)
    track = circle + np.random.default_rng(2).normal(0.0, 0.4, circle.shape)
    for bound in (0.2, 3.0):
        result = smoothed(track, 0.94, 6.0, bound, closed)
        assert np.linalg.norm(result - track, axis=1).max() <= bound * (1.0 + 1e-9)
    assert np.linalg.norm(result - circle, axis=1).mean() < 0.25


def test_a_straight_line_stays_where_it_is() -> None:
    line = np.column_stack([np.arange(100.0), 3.0 * np.arange(100.0)])
    assert smoothed(line, 1.0, 10.0, 1.0, closed=False) == pytest.approx(line, abs=1e-6)


def test_pairs_come_to_one_height() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    eight = np.stack([200.0 * np.sin(t + 0.3), 100.0 * np.sin(2.0 * (t + 0.3))], axis=1)
    heights = (4.0 * np.cos(t + 0.3))[:, None]
    pairs = meetings(eight, 2.0, 3.0, 30.0, closed=True)
    assert len(pairs)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert np.abs(heights[pairs[:, 0]] - heights[pairs[:, 1]]).min() > 7.0
    result = smoothed(heights, 2.0, 30.0, 1.0, True, pairs)
    assert np.abs(result[pairs[:, 0]] - result[pairs[:, 1]]).max() < 0.1
