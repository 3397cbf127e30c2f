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
    script = script_of("vertical-leap", sex)
    disturbed = [{"height": 0.5, **values} for values in script.varied(13, seed=3)]
    leaps = leap(gymnast_of(sex), script, [*({"height": height} for height in HEIGHTS), *disturbed], SETTINGS)
    np.testing.assert_allclose(leaps.rise[:3], HEIGHTS, atol=0.05)
    assert leaps.balanced[:3].all()
    assert leaps.balanced[3:].mean() >= 0.8
    assert np.abs(leaps.distance[:3]).max() < 0.3
    # From the crouch to liftoff, as people need.
    assert 0.8 < leaps.liftoff[1] < 1.4


@pytest.mark.parametrize("sex", ["male", "female"])
def test_broad_jumps_travel_as_commanded_and_end_balanced(sex: str) -> None:
    script = script_of("broad-jump", sex)
    longest = LONGEST[sex]
    disturbed = [{"distance": longest, **values} for values in script.varied(14, seed=3)]
    jumps = leap(gymnast_of(sex), script, [{"distance": 1.2}, {"distance": longest}, *disturbed], SETTINGS)
    np.testing.assert_allclose(jumps.distance[:2], (1.2, longest), atol=0.1)
    assert jumps.balanced[:2].all()
    assert jumps.balanced[2:].mean() >= 0.8


@pytest.mark.parametrize("sex", ["male", "female"])
def test_flexed_hips_at_liftoff_turn_forwards_and_extended_ones_backwards(sex: str) -> None:
    leaps = rotating_leaps(sex, [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0], SETTINGS)
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


def test_a_pitch_of_the_legs_flexes_the_hips() -> None:
    body = gymnast_of("male").body
    text = "[[row]]\nlegs = { length = 0.6, pitch = 0.4 }"
    layout = gymnast_of("male").script
    row = parse_script(text, "x").table(body)[0]
    hip, knee, ankle = leg_angles(leg_geometry(body), 0.6)
    found = [row[layout.channels.index(f"left_{name}")] for name in ("hip", "knee", "ankle")]
    np.testing.assert_allclose(found, (hip - 0.4, knee, ankle), atol=1e-6)
