"""How fast a road may be ridden, against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest

from echelon.flocking.corner_speeds import FASTEST, GRAVITY, SMOOTHED, SPEED_LANES, corner_speeds
from echelon.scenario.road import PelotonSettings
from echelon.terrain.spline import Centreline
from tests.flocking.point_cyclists import rounded, straight

SETTINGS = PelotonSettings()


def test_speeds_are_the_fastest_that_lean_and_braking_allow() -> None:
    path = rounded(60.0, 40.0, 14.0)
    table = corner_speeds(SETTINGS, path, 3.0, "cpu")
    squares, step = table.squares.numpy(), table.step
    count = squares.shape[1]
    s = step * np.arange(count)
    spread = np.linspace(-0.5 * SMOOTHED, 0.5 * SMOOTHED, 9)
    bend = np.mean([path.curvature(s + ahead) for ahead in spread], axis=0)
    for lane, offset in enumerate(np.linspace(-3.0, 3.0, SPEED_LANES)):
        part = 1.0 - bend * offset
        allowed = GRAVITY * math.tan(SETTINGS.corner_lean) * part / np.maximum(np.abs(bend), 1e-9)
        expected = np.minimum(allowed, FASTEST**2)
        for _ in range(2):  # round and round, against the riding
            for k in reversed(range(count)):
                after = (k + 1) % count
                braked = expected[after] + 2.0 * SETTINGS.corner_braking * step * part[after]
                expected[k] = min(expected[k], braked)
        np.testing.assert_allclose(squares[lane], expected, rtol=1e-4)


def test_the_inside_of_a_corner_is_slower() -> None:
    squares = corner_speeds(SETTINGS, rounded(60.0, 40.0, 14.0), 3.0, "cpu").squares.numpy()
    assert np.sqrt(squares[0].min()) > np.sqrt(squares[-1].min()) + 0.5, "bends are to the left, offsets grow that way"


@pytest.mark.parametrize("closed", [False, True])
def test_a_road_without_corners_is_not_slow(closed: bool) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    circle = np.column_stack([300.0 * np.cos(turn), 300.0 * np.sin(turn), 0.0 * turn])
    path = Centreline(circle, closed=True) if closed else straight()
    squares = corner_speeds(SETTINGS, path, 3.0, "cpu").squares.numpy()
    assert np.sqrt(squares.min()) > 25.0
