"""Riders are timed on a road that goes up and down, and only while they ride as riders should."""

from __future__ import annotations

from functools import cache

import numpy as np

from echelon.agents.riders.cyclist import Cyclist
from echelon.benchmarks.riding_run import (
    HALF_WIDTH,
    RIDING_SPEED,
    RIDING_STRIDE,
    START,
    START_LENGTH,
    RidingRun,
    rolling_road,
)

RIDERS = 8


@cache
def cyclist() -> Cyclist:
    return Cyclist()


def run() -> RidingRun:
    return RidingRun(cyclist(), RIDERS, RIDING_STRIDE, "semi-implicit")


def places(riding: RidingRun) -> np.ndarray:
    """Where each one's rear wheel touches, in the world [m], shape [riders, 3]."""
    return riding.engine.origins.numpy()[:RIDERS] + riding.engine.q[:, :3]


def test_the_road_is_straight_and_goes_up_and_down():
    road = rolling_road()
    s = np.linspace(START, START + START_LENGTH, 101)
    assert np.max(np.abs(road.centreline.curvature(s))) < 1e-9
    grades = road.centreline.grade(s)
    assert grades.min() < -0.02
    assert grades.max() > 0.02
    edges = np.column_stack([s, np.full_like(s, HALF_WIDTH)])
    assert np.max(np.abs(road.height(edges) - road.centreline.position(s)[:, 2])) < 0.05


def test_riders_who_ride_have_a_rate_and_both_wheels_find_the_road():
    riding = run()
    engine = riding.engine
    before = places(riding)
    assert riding.round() > 0.0
    assert riding.verdict().sane, riding.verdict().why
    found = places(riding)
    assert np.allclose(found[:, 0] - before[:, 0], RIDING_SPEED, atol=0.3)
    # The root is where the rear tyre touches; it sinks in by some two millimetres.
    assert np.max(np.abs(found[:, 2] - rolling_road().height(found[:, :2]))) < 0.005
    assert np.all(engine.memory("loaded") > 0.5)
    engine.close()


def test_riders_who_do_not_hold_their_speed_have_none():
    riding = run()
    riding.engine.set_command("velocity_x", np.full(RIDERS, RIDING_SPEED + 1.0))
    riding.round()
    verdict = riding.verdict()
    assert not verdict.sane
    assert "error of speed" in verdict.why
    riding.engine.close()


def test_one_rider_who_lies_on_the_road_is_enough():
    riding = run()
    q = riding.engine.q
    q[3, 3:7] = (np.sin(0.7), 0.0, 0.0, np.cos(0.7))
    riding.engine.set_q(q)
    riding.round()
    verdict = riding.verdict()
    assert not verdict.sane
    assert "1 of 8 riders fell" in verdict.why
    riding.engine.close()
