"""Leap: gymnasts rise as high and travel as far as they are told, land, and find their balance."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.gymnasts.body import leg_geometry
from echelon.agents.gymnasts.script import leg_angles, parse_script
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.leap import leap, rotating_leaps, script_of
from echelon.benchmarks.thesis.trials import gymnast_of

SETTINGS = FidelitySettings()
HALVED = FidelitySettings(steps_per_second=2400)
HEIGHTS = (0.2, 0.5, 1.0)
LONGEST = {"male": 2.12, "female": 1.57}


@pytest.mark.parametrize("sex", ["male", "female"])
def test_vertical_leaps_rise_as_commanded_and_end_balanced(sex: str) -> None:
    # Between the heights that were tuned too: the man once fell from 0.15 m.
    heights = np.arange(0.1, 1.01, 0.05)
    script = script_of("vertical-leap", sex)
    leaps = leap(gymnast_of(sex), script, [{"height": float(height)} for height in heights], SETTINGS)
    np.testing.assert_allclose(leaps.rise, heights, atol=0.05)
    assert leaps.balanced.all(), heights[~leaps.balanced]
    assert np.abs(leaps.distance).max() < 0.3
    # From the crouch to liftoff, as people need.
    assert 0.8 < leaps.liftoff[8] < 1.4


@pytest.mark.parametrize("sex", ["male", "female"])
def test_broad_jumps_travel_as_commanded_and_end_balanced(sex: str) -> None:
    # Between the distances that were tuned too: the man once fell from 0.5 to 0.65 m.
    distances = np.append(np.arange(0.4, LONGEST[sex], 0.1), LONGEST[sex])
    script = script_of("broad-jump", sex)
    jumps = leap(gymnast_of(sex), script, [{"distance": float(distance)} for distance in distances], SETTINGS)
    np.testing.assert_allclose(jumps.distance, distances, atol=0.05)
    assert jumps.balanced.all(), distances[~jumps.balanced]


@pytest.mark.parametrize("sex", ["male", "female"])
@pytest.mark.parametrize(("maneuver", "command"), [("vertical-leap", "height"), ("broad-jump", "distance")])
def test_disturbed_leaps_end_balanced(maneuver: str, command: str, sex: str) -> None:
    script = script_of(maneuver, sex)
    told = (0.15, 0.5, 1.0) if command == "height" else (0.6, 0.8, LONGEST[sex])
    values = [{command: one, **disturbed} for one in told for disturbed in script.varied(12, seed=3)]
    leaps = leap(gymnast_of(sex), script, values, SETTINGS)
    shares = leaps.balanced.reshape(len(told), -1).mean(axis=1)
    assert (shares >= 0.8).all(), shares


@pytest.mark.parametrize("sex", ["male", "female"])
def test_flexed_hips_at_liftoff_turn_forwards_and_extended_ones_backwards(sex: str) -> None:
    # The woman once stayed on the ground from -2.1 rad on.
    leaps = rotating_leaps(sex, [-2.8, -2.4, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0], SETTINGS)
    assert leaps.left.all()
    assert (np.diff(leaps.momentum) < 0.0).all()
    assert leaps.momentum[0] > 0.0 > leaps.momentum[-1]


def test_half_the_step_changes_rise_momentum_and_push_by_little() -> None:
    values = [{"height": height} for height in HEIGHTS]
    usual, halved = (
        leap(gymnast_of("male"), script_of("vertical-leap", "male"), values, s) for s in (SETTINGS, HALVED)
    )
    np.testing.assert_allclose(halved.rise, usual.rise, rtol=0.05)
    np.testing.assert_allclose(halved.push, usual.push, rtol=0.05)
    # About none: as a part of what a somersault has.
    np.testing.assert_allclose(halved.momentum, usual.momentum, atol=0.05 * 60.0)
    assert halved.balanced.all()


def test_half_the_step_changes_how_far_the_man_jumps_by_little() -> None:
    # One who topples through his crouch instead of standing in it leaves the ground otherwise with every step.
    values = [{"distance": distance} for distance in (0.6, 1.2, 1.6, 2.12)]
    usual, halved = (leap(gymnast_of("male"), script_of("broad-jump", "male"), values, s) for s in (SETTINGS, HALVED))
    np.testing.assert_allclose(halved.distance, usual.distance, rtol=0.05)
    np.testing.assert_allclose(halved.rise, usual.rise, rtol=0.05)
    assert halved.balanced.all()


def test_a_pitch_of_the_legs_flexes_the_hips() -> None:
    body = gymnast_of("male").body
    text = "[[row]]\nlegs = { length = 0.6, pitch = 0.4 }"
    layout = gymnast_of("male").script
    row = parse_script(text, "x").table(body)[0]
    hip, knee, ankle = leg_angles(leg_geometry(body), 0.6)
    found = [row[layout.channels.index(f"left_{name}")] for name in ("hip", "knee", "ankle")]
    np.testing.assert_allclose(found, (hip - 0.4, knee, ankle), atol=1e-6)
