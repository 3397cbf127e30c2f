"""Four dives from 10 m: they enter turned and twisted as they should, also when disturbed, and with a finer step."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from echelon.agents.gymnasts.script import load_script
from echelon.benchmarks.thesis.dives import DIVES, SEED, dive
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.trials import gymnast_of
from echelon.scenario import Scenario
from echelon.simulation import simulate

SETTINGS = FidelitySettings(threads=1)
ROWS = {
    row.given["dive"]: (row.body, row.thesis)
    for row in published_rows("dives")
    if row.quantity == "somersault at entry"
}
TWISTS = {row.given["dive"]: row.thesis for row in published_rows("dives") if row.quantity == "twist at entry"}


@pytest.mark.parametrize("name", DIVES)
def test_a_dive_enters_as_asked_and_so_do_disturbed_ones(name: str) -> None:
    body, somersault = ROWS[name]
    character, script = gymnast_of(body), load_script(DIVES[name])
    dives = dive(character, script, [{}, *script.varied(23, SEED)], SETTINGS)
    good = dives.entered(math.radians(somersault or 0.0), math.radians(TWISTS[name] or 0.0))
    assert good[0]
    assert good.mean() >= 0.8
    # Inward dives turn forwards, back dives backwards; all leap away from the platform.
    assert (np.sign(dives.somersault) == (1.0 if name.startswith("inward") else -1.0)).all()
    assert (dives.away > 0.5).all()


def test_a_diver_who_does_not_leap_away_meets_the_platform() -> None:
    character, script = gymnast_of("male"), load_script("inward-dive-one-and-a-half-pike")
    dives = dive(character, script, [{"crouch_x": 0.07, "fall_x": 0.08}] * 8, SETTINGS)
    assert not dives.entered(math.radians(540.0), 0.0).any()


def test_the_opening_waits_for_rotation() -> None:
    character, script = gymnast_of("male"), load_script("inward-dive-one-and-a-half-pike")
    usual = script.parameters["open_at"].value
    dives = dive(character, script, [{"open_at": usual + by} for by in (-1.0, -0.5, 0.0, 0.5)], SETTINGS)
    assert (np.diff(dives.somersault) > 0.3).all()


def test_the_fastest_twist_keeps_its_momentum(tmp_path: Path) -> None:
    """Two and a half twists in a second, servos at work: what the step would add is some percent a second."""
    recording = simulate(Scenario.load(DIVES["back 1 1/2 with 2 1/2 twists"]), recording=tmp_path / "dive", threads=1)

    def measured(name: str) -> np.ndarray:
        return recording.measures[:, 0, recording.measure_names.index(name)]

    momentum = np.linalg.norm([measured(f"momentum_{axis}") for axis in "xyz"], axis=0)
    twist = np.abs(measured("twist"))
    above_water = recording.link_poses[:, 0, :, 2].min(axis=1) > 0.0
    flight = (measured("foot_force") == 0.0) & above_water & (twist > 0.01)
    assert twist[flight].max() > math.radians(850.0)
    np.testing.assert_allclose(momentum[flight], momentum[flight][0], rtol=5e-3)
