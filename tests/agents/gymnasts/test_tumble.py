"""Bodies in flight: positions with the thesis's inertias, and what they do with angular momentum, or without any."""

from __future__ import annotations

import math

import numpy as np
import pytest

from echelon.agents.gymnasts.airborne import airborne_population
from echelon.agents.gymnasts.channels import CHANNELS
from echelon.agents.gymnasts.poses import inertia_tensor, poses
from echelon.agents.gymnasts.posture import positions_of
from echelon.agents.gymnasts.script import parse_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, run_thesis_benchmark
from echelon.benchmarks.thesis.trials import gymnast_of
from echelon.benchmarks.thesis.tumble import MEASURES, POSITION, fly
from echelon.errors import InputError
from echelon.warp_kernels.reference_run import ReferenceRun

SETTINGS = FidelitySettings(threads=1)


@pytest.mark.parametrize(
    ("sex", "pose", "inertia", "near"),
    [
        ("male", "layout", 18.31, 0.03),
        ("male", "pike", 5.84, 0.08),
        ("male", "tuck", 4.84, 0.08),
        ("female", "layout", 7.43, 0.03),
        ("female", "pike", 2.52, 0.08),
        ("female", "tuck", 1.92, 0.08),
    ],
)
def test_positions_have_the_inertias_of_the_thesis(sex: str, pose: str, inertia: float, near: float) -> None:
    body = gymnast_of(sex).body
    assert inertia_tensor(body, positions_of(body, poses()[pose]))[1, 1] == pytest.approx(inertia, rel=near)


def test_the_inertia_tensor_is_about_the_centre_and_turns_with_the_body() -> None:
    body = gymnast_of("male").body
    q = positions_of(body, poses()["thrown"])
    upright = inertia_tensor(body, q)
    # Another way: links as points with inertias of their own.
    expected = np.zeros((3, 3))
    center = body.center_of_mass(q)
    u = np.zeros((3, body.u_count))
    for axis in range(3):
        u[axis, 3 + axis] = 1.0
    spin = body.momentum(np.tile(q, (3, 1)), u)[:, 3:6]
    expected = spin.T
    np.testing.assert_allclose(upright, expected, atol=1e-9)
    np.testing.assert_allclose(upright, upright.T, atol=1e-9)
    moved = q.copy()
    moved[:3] += (3.0, -2.0, 5.0)
    assert not np.allclose(body.center_of_mass(moved), center)
    np.testing.assert_allclose(inertia_tensor(body, moved), upright, atol=1e-9)
    half = 0.3
    turned = q.copy()
    turned[3:7] = (0.0, math.sin(half), 0.0, math.cos(half))
    c, s = math.cos(2.0 * half), math.sin(2.0 * half)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    np.testing.assert_allclose(inertia_tensor(body, turned), rotation @ upright @ rotation.T, atol=1e-9)


def test_poses_name_channels_and_rows_may_change_them() -> None:
    for channels in poses().values():
        assert set(channels) <= set(CHANNELS)
    body = gymnast_of("male").body
    rows = "[[row]]\npose = 'tuck'\nchannels = { knee = 1.0 }\n"
    row = parse_script(rows, "x").table(body)[0]
    assert row[CHANNELS.index("left_hip")] == pytest.approx(poses()["tuck"]["left_hip"])
    assert row[CHANNELS.index("right_knee")] == 1.0
    with pytest.raises(InputError, match="did you mean 'tuck'"):
        parse_script("[[row]]\npose = 'tuk'\n", "x")


@pytest.mark.parametrize("sex", ["male", "female"])
def test_those_who_start_in_the_air_have_the_momentum_and_the_height_that_was_asked(sex: str) -> None:
    character = gymnast_of(sex)
    momentum, velocity = np.array([[3.0, -40.0, 2.0], [0.0, 20.0, 0.0]]), (1.0, 0.5, -2.0)
    people = airborne_population(character, poses()["pike"], 2, height=30.0, velocity=velocity, momentum=momentum)
    found = character.body.momentum(people.q, people.u)
    np.testing.assert_allclose(found[:, 3:], momentum, atol=1e-9)
    np.testing.assert_allclose(found[:, :3], np.tile(velocity, (2, 1)) * character.body.mass, atol=1e-9)
    np.testing.assert_allclose(character.body.center_of_mass(people.q), [[0.0, 0.0, 30.0]] * 2, atol=1e-12)


@pytest.mark.parametrize("experiment", MEASURES)
def test_tumbles_are_as_the_thesis_asks(experiment: str) -> None:
    rows = run_thesis_benchmark(only=[experiment], settings=SETTINGS)
    assert [(row.body, row.condition, row.quantity, row.ours) for row in rows if row.met is not True] == []


def test_momentum_is_kept_better_with_a_finer_step() -> None:
    drifts = []
    for steps in (1200, 2400):
        settings = FidelitySettings(threads=1, steps_per_second=steps)
        flight = fly(gymnast_of("male"), POSITION.format(pose="tuck"), poses()["layout"], 1.0, settings, momentum=55.0)
        drifts.append(np.abs(flight.momentum[:, 0] / flight.momentum[0, 0] - 1.0).max())
    # Semi-implicit Euler: the error is of the first order.
    assert drifts[0] < 0.006
    assert drifts[1] == pytest.approx(0.5 * drifts[0], rel=0.3)


def test_a_twist_is_the_angle_about_the_long_axis_and_not_what_its_rate_adds_up_to() -> None:
    # A body that somersaults tilted by theta turns about its long axis by sin(theta) times the somersault, untwisted.
    character = gymnast_of("male")
    q = positions_of(character.body, poses()["layout"])
    tilt, turns = 0.2, np.linspace(0.0, 3.0, 40)
    memory = {name: np.array([value]) for name, value in character.memory.items()}
    for turn in turns:
        run = ReferenceRun(character, _turned(q, turn, tilt), np.zeros((1, character.body.u_count)))
        for name, values in memory.items():
            run.state.memory[name] = values
        run.control()
        memory = dict(run.state.memory)
    assert memory["somersault"][0] == pytest.approx(turns[-1], abs=1e-6)
    assert memory["twist"][0] == pytest.approx(0.0, abs=1e-6)


def _turned(q: np.ndarray, somersault: float, tilt: float) -> np.ndarray:
    """Turned about y by the somersault, then tilted about its own x; shape [1, q_count]."""
    cy, sy, cx, sx = (
        math.cos(0.5 * somersault), math.sin(0.5 * somersault), math.cos(0.5 * tilt), math.sin(0.5 * tilt)
    )  # fmt: skip
    turned = np.array(q)[None].copy()
    turned[0, 3:7] = (cy * sx, sy * cx, -sy * sx, cy * cx)
    return turned
