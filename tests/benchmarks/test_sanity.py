"""What the benchmark calls sane: each criterion, on states made up to meet or to break it."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.bodies import load_body
from echelon.agents.riders.cyclist import Cyclist
from echelon.benchmarks.engine_runs import flight_states
from echelon.benchmarks.sanity import (
    judge_flight,
    judge_hopping,
    judge_riding,
    judge_rolling,
    judge_standing,
    lean_of,
    spring_gaps,
)
from echelon.warp_kernels.reference import Body

AGENTS = 4


def leaps(name: str = "hopper") -> tuple[Body, np.ndarray, np.ndarray]:
    body = load_body(name)
    return body, *flight_states(body, AGENTS)


def nobody() -> np.ndarray:
    return np.zeros(AGENTS, dtype=bool)


def test_the_first_leaps_are_the_same_however_many_there_are():
    body = load_body("hopper")
    few, many = flight_states(body, 3), flight_states(body, 8)
    assert np.array_equal(few[0], many[0][:3])
    assert np.array_equal(few[1], many[1][:3])


@pytest.mark.parametrize("name", ["hopper", "male"])
def test_flight_that_goes_nowhere_is_sane(name: str):
    body, q, u = leaps(name)
    assert judge_flight(body, [(q, u), (q, u)], 1.0, 300.0).sane


def test_a_quaternion_that_is_not_of_unit_length():
    body, q, u = leaps()
    long = q.copy()
    long[2, 3:7] *= 1.01
    verdict = judge_flight(body, [(q, u), (long, u)], 1.0, 0.0)
    assert not verdict.sane
    assert "unit length" in verdict.why


def test_a_state_that_is_not_finite():
    body, q, u = leaps()
    lost = u.copy()
    lost[1, 7] = np.nan
    verdict = judge_flight(body, [(q, u), (q, lost)], 1.0, 0.0)
    assert not verdict.sane
    assert "1 of 4" in verdict.why


def test_angular_momentum_that_drifts():
    body, q, u = leaps()
    slower = u.copy()
    slower[0, 3:] *= 0.97
    assert not judge_flight(body, [(q, u), (q, slower)], 1.0, 0.0).sane
    assert judge_flight(body, [(q, u), (q, slower)], 2.0, 0.0).sane  # the same in twice the time is half as fast


def test_energy_that_rises_on_the_way():
    body, q, u = leaps()
    # Legs that rush in and out carry no angular momentum at the end, but energy in between.
    rushing = u.copy()
    rushing[:, 9] += 8.0
    verdict = judge_flight(body, [(q, u), (q, rushing), (q, u)], 1.0, 0.0)
    assert not verdict.sane
    assert "energy" in verdict.why


def test_springs_that_are_stretched_count_as_energy():
    body, q, u = leaps()
    q[:, 7:], u[:, 6:] = 0.0, 0.0
    stretched = q.copy()
    stretched[:, 10] += 0.01  # the leg: 0.3 J of some 5 J at 6000 N/m, and hardly another moment of inertia
    assert judge_flight(body, [(q, u), (stretched, u), (q, u)], 1.0, 0.0).sane
    assert not judge_flight(body, [(q, u), (stretched, u), (q, u)], 1.0, 6000.0).sane


def test_hoppers_that_are_too_slow():
    body, q, u = leaps()
    assert judge_hopping(body, q, u, nobody(), nobody(), np.array([0.0, 0.1, 0.14, 0.02])).sane
    verdict = judge_hopping(body, q, u, nobody(), nobody(), np.array([0.0, 0.1, 0.16, 0.02]))
    assert not verdict.sane
    assert "0.160 m/s" in verdict.why


def test_a_body_that_stands_falls_or_gains_energy():
    body = load_body("hopper")
    count = 50
    q = np.tile(body.q_reference, (count, 1))
    u = np.zeros((count, body.u_count))
    no_springs = np.zeros(body.q_count)
    assert judge_standing(body, q, u, no_springs, 1.0).sane
    assert not judge_standing(body, q, u, no_springs, 0.0).sane
    lying = q.copy()
    lying[-1, 3:7] = (np.sin(0.6), 0.0, 0.0, np.cos(0.6))
    assert judge_standing(body, lying, u, no_springs, 1.0).why == "it fell"
    rising = q.copy()
    rising[-1, 2] += 0.05
    assert "energy rises" in judge_standing(body, rising, u, no_springs, 1.0).why


# ---- riders ----------------------------------------------------------------------------------------------------------
def riders(count: int) -> tuple[Body, np.ndarray, np.ndarray]:
    """Riders at 6 m/s, upright, hands and feet on."""
    cyclist, each = Cyclist(), np.ones(count)
    return cyclist.body, *cyclist.riding(0.0 * each, 6.0 * each, 0.0 * each, 0.3 * each, 2.0 * each)


@pytest.mark.parametrize(
    ("error", "lean", "gap", "reason"),
    [
        (0.2, 0.02, 0.004, ""),
        (0.4, 0.02, 0.004, "0.40 m/s"),
        (0.2, 0.10, 0.004, "leans by 5.7 degrees"),
        (0.2, 0.02, 0.012, "12.0 mm"),
        (0.2, 0.02, np.nan, "from where it belongs"),
    ],
)
def test_riders_are_judged_by_the_worst_of_them(error: float, lean: float, gap: float, reason: str):
    body, q, u = riders(AGENTS)
    found = np.zeros((3, AGENTS))
    found[:, 2] = error, lean, gap
    verdict = judge_riding(body, q, u, nobody(), nobody(), *found)
    assert verdict.sane == (not reason)
    assert reason in verdict.why


def test_a_rider_who_fell_or_was_lost():
    body, q, u = riders(AGENTS)
    one = nobody()
    one[1] = True
    well = np.zeros((3, AGENTS))
    assert "1 of 4 riders fell" in judge_riding(body, q, u, one, nobody(), *well).why
    assert "finite" in judge_riding(body, q, u, nobody(), one, *well).why
    assert not judge_riding(body, q, np.where(one[:, None], np.inf, u), nobody(), nobody(), *well).sane


def test_a_rider_who_rolls_slides_tips_or_gains_energy():
    body, q, u = riders(20)
    none = np.zeros(20)
    assert judge_rolling(body, q, u, none, 1.0, 0.004, 0.05).sane
    assert "both wheels" in judge_rolling(body, q, u, none, 0.9, 0.004, 0.05).why
    assert "slips" in judge_rolling(body, q, u, none, 1.0, 0.004, 0.2).why
    assert "12.0 mm" in judge_rolling(body, q, u, none, 1.0, 0.012, 0.05).why
    faster = u.copy()
    faster[10, 0] += 0.1
    assert "energy rises" in judge_rolling(body, q, faster, none, 1.0, 0.004, 0.05).why
    # What the springs give back is none that is gained.
    given_back = np.linspace(100.0, 0.0, 20)
    assert judge_rolling(body, q, faster, given_back, 1.0, 0.004, 0.05).sane
    tipping = q.copy()
    tipping[-1, 3:7] = (np.sin(0.1), 0.0, 0.0, np.cos(0.1))
    assert "leans by 11.5 degrees" in judge_rolling(body, tipping, u, none, 1.0, 0.004, 0.05).why


def test_gaps_are_those_between_the_ends_of_springs():
    body, q, _ = riders(1)
    closed = spring_gaps(body, body.link_poses(q))
    assert closed.shape == (1, len(body.springs))
    assert closed.max() < 1e-6
    ankle = body.coordinate_names.index("left_ankle")
    q[0, ankle] += 0.1
    opened = spring_gaps(body, body.link_poses(q))[0]
    (pedal,) = np.flatnonzero(opened > 1e-3)
    assert body.springs[pedal].name == "left_pedal"
    assert opened[pedal] == pytest.approx(2.0 * np.sin(0.05) * np.hypot(0.11, 0.10), rel=0.02)


def test_lean_is_against_gravity_whatever_the_heading():
    yaw, lean = 1.1, -0.3
    heading = np.array([0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    x, w = np.sin(0.5 * lean), np.cos(0.5 * lean)
    z, v = heading[2], heading[3]
    turned = np.array([v * x, z * x, z * w, v * w])  # heading, then lean about the bicycle's own x
    assert lean_of(turned) == pytest.approx(lean)
