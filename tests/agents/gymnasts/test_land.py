"""Land: gymnasts who fall, also with horizontal speed, come down on their feet and find their balance."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.gymnasts.gymnast import gymnast
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.land import falls_onto_feet, growth, land
from echelon.benchmarks.thesis.leap import script_of
from echelon.benchmarks.thesis.trials import gymnast_of

SETTINGS = FidelitySettings()
GREATEST = {"male": 1.15, "female": 0.92}


@pytest.mark.parametrize("sex", ["male", "female"])
def test_falls_are_landed_and_the_peak_force_grows_like_the_root_of_the_height(sex: str) -> None:
    falls = np.array([0.25, 0.35, 0.45, 0.6, 0.75, 0.85, GREATEST[sex], 1.3])
    landings = falls_onto_feet(gymnast_of(sex), script_of("drop-landing", sex), falls, SETTINGS)
    assert landings.balanced.all()
    assert growth(falls, landings.peak) == pytest.approx(0.5, abs=0.2)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_feet_come_down_where_the_speed_asks_for_them(sex: str) -> None:
    speeds = np.array([-1.0, 0.0, 1.0, 2.0])
    values = [{"speed": speed} for speed in speeds]
    landings = land(gymnast_of(sex), script_of("drop-landing", sex), values, SETTINGS, speeds=speeds)
    assert landings.balanced.all()
    assert (np.diff(landings.feet_ahead) > 0.0).all()
    assert np.abs(landings.speed_at_balance).max() < 0.4


def test_feet_that_come_down_behind_do_not_stop_a_fast_body() -> None:
    speeds = np.array([2.0])
    values = [{"speed": 2.0, "feet": -0.3}]
    landings = land(gymnast_of("male"), script_of("drop-landing", "male"), values, SETTINGS, speeds=speeds)
    assert not landings.balanced.any()


def test_a_mat_takes_a_fifth_of_the_force() -> None:
    falls = np.array([0.45, 0.75, 1.15])
    script = script_of("drop-landing", "male")
    floor = falls_onto_feet(gymnast_of("male"), script, falls, SETTINGS)
    mat = falls_onto_feet(gymnast("male", mat=True), script, falls, SETTINGS)
    assert mat.balanced.all()
    assert (mat.peak < 0.87 * floor.peak).all()
