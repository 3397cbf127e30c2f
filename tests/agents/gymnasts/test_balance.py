"""Gymnasts keep their balance: they stand, bend, touch their toes, lean, are pushed, and stand on slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from echelon.agents.gymnasts.body import leg_geometry
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.posture import balanced_legs, channels_of, middle_of_feet, positions_of
from echelon.agents.gymnasts.script import load_script, maneuver_names
from echelon.agents.gymnasts.standing import standing_q
from echelon.benchmarks.thesis.balance import standing
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.trials import gymnast_of, trials
from echelon.simulation.performance import Performance

SETTINGS = FidelitySettings()


@pytest.mark.parametrize("sex", ["male", "female"])
def test_standing_is_quiet_and_carries_the_weight(sex: str) -> None:
    character = gymnast_of(sex)
    run = trials(character, load_script("stand"), [{}] * 8, SETTINGS)
    seen = run.run(5.0, ["com_x", "foot_force"])
    assert standing(run).all()
    assert np.abs(seen["com_x"][-60:]).max() < 0.02
    weight = character.body.mass * character.body.gravity
    assert seen["foot_force"][-60:].mean() == pytest.approx(weight, rel=0.01)


@pytest.mark.parametrize(("sex", "least"), [("male", 110.0), ("female", 60.0)])
def test_pushes_of_a_quarter_of_a_second_are_stood_from_every_side(sex: str, least: float) -> None:
    angles = np.arange(8) * math.pi / 4.0
    values = [{"push_x": least * math.cos(a), "push_y": least * math.sin(a)} for a in angles]
    # Twice as strong pushes fell everybody, so the trial tells one from the other.
    values += [{name: 2.5 * force for name, force in value.items()} for value in values]
    run = trials(gymnast_of(sex), load_script("sway"), values, SETTINGS)
    run.run(10.0)
    assert standing(run)[:8].all()
    assert not standing(run)[8:].any()


def test_who_falls_lies_on_the_ground_and_comes_to_rest() -> None:
    character = gymnast_of("male")
    angles = np.arange(8) * math.pi / 4.0
    values = [{"push_x": 320.0 * math.cos(a), "push_y": 320.0 * math.sin(a)} for a in angles]
    run = trials(character, load_script("sway"), values, SETTINGS)
    seen = run.run(12.0, ["q", "u", "fallen"])
    assert (seen["fallen"][-1] > 0.5).all()
    center = character.body.center_of_mass(seen["q"][-1])
    assert (center[:, 2] < 0.35).all()
    heights = character.body.link_poses(seen["q"][-1])[:, :, 2]
    assert heights.min() > -0.08
    assert np.abs(seen["u"][-1][:, :3]).max() < 0.1


def test_knees_bend_to_the_thesis_s_heights_and_straighten_again() -> None:
    for sex, height in (("male", 0.52), ("female", 0.47)):
        character = gymnast_of(sex)
        run = trials(character, load_script("knee-bend"), [{"depth": height - 0.03}], SETTINGS)
        q = run.run(6.5, ["q"])["q"][:, 0]
        hips = character.body.link_poses(q)[:, character.body.link_index("left_upper_leg"), 2]
        assert hips.min() == pytest.approx(height, abs=0.03)
        assert hips[int(5.0 * 30)] > hips[0] - 0.03
        assert run.now("fallen")[0] == 0.0


def test_toes_are_touched_with_balance_and_not_without() -> None:
    run = trials(gymnast_of("female"), load_script("toe-touch"), [{"balance": 1.0}, {"balance": 0.0}], SETTINGS)
    run.run(9.0)
    assert standing(run).tolist() == [True, False]


def test_the_centre_of_mass_goes_where_it_is_asked_to() -> None:
    asked = (-0.04, -0.02, 0.0, 0.02, 0.04)
    run = trials(gymnast_of("male"), load_script("sway"), [{"com_x": x} for x in asked], SETTINGS)
    run.run(9.0)
    assert standing(run).all()
    reached = run.now("com_x")
    assert np.all(np.diff(reached) > 0.008)
    assert reached == pytest.approx(asked, abs=0.02)


def test_a_squat_s_legs_put_the_centre_of_mass_over_the_feet() -> None:
    body = gymnast_of("male").body
    for ahead in (-0.02, 0.0, 0.03):
        hip, knee, ankle = balanced_legs(body, leg_geometry(body), 0.6, 0.4, ahead, {})
        assert 0.4 + hip + knee + ankle == pytest.approx(0.0, abs=1e-9)
        angles = {"hip": hip, "knee": knee, "ankle": ankle}
        legs = {f"{side}_{name}": angle for side in ("left", "right") for name, angle in angles.items()}
        q = positions_of(body, {**legs})
        q[3:7] = (0.0, math.sin(0.2), 0.0, math.cos(0.2))
        assert body.center_of_mass(q)[0] - middle_of_feet(body, q) == pytest.approx(ahead, abs=2e-3)


def test_channels_and_positions_are_the_same_posture() -> None:
    body = gymnast_of("female").body
    q = standing_q(body, knee_flexion=0.3)
    channels = channels_of(body, q)
    again = positions_of(
        body, channels | {f"{side}_shoulder_spread": 0.5 * math.pi - 1.35 for side in ("left", "right")}
    )
    assert again[7:] == pytest.approx(q[7:], abs=1e-9)


@pytest.mark.parametrize("name", maneuver_names())
def test_every_maneuver_that_ships_makes_a_table(name: str) -> None:
    script = load_script(name)
    table = script.table(gymnast_of(script.body if script.body in ("male", "female") else "male").body)
    assert table.shape == (len(script.rows), Gymnast.script.row_size)
    assert script.title


def test_a_performance_restarts_to_the_same_bytes() -> None:
    character = gymnast_of("male")
    table = load_script("knee-bend").table(character.body)
    run = Performance(character, [table] * 3)
    run.run(0.5)
    first = run.engine.full_state()["state"]
    run.restart([table] * 3)
    run.run(0.5)
    assert np.array_equal(first, run.engine.full_state()["state"])
