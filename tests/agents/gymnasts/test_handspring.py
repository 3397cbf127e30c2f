"""The back handspring that ships: over the hands onto the feet, balanced also when disturbed; and its failure falls."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.gymnasts.airborne import airborne_population
from echelon.agents.gymnasts.body import HAND_SITES, site_points
from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.joints import speed_index
from echelon.agents.gymnasts.posture import positions_of
from echelon.agents.gymnasts.script import Script, load_script, parse_script
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.handspring import FAILURE, Handsprings, perform
from echelon.benchmarks.thesis.trials import gymnast_of, trials
from echelon.simulation.performance import Performance
from echelon.warp_kernels.contact import JointForces

DISTURBED = 38


@pytest.fixture(scope="module")
def character() -> Gymnast:
    return gymnast_of("male")


@pytest.fixture(scope="module")
def script() -> Script:
    return load_script("back-handspring")


@pytest.fixture(scope="module")
def performed(character: Gymnast, script: Script) -> Handsprings:
    """The usual one, the failure, and disturbed ones."""
    return perform(character, script, [{}, FAILURE, *script.varied(DISTURBED, 7)], FidelitySettings())


def test_ends_balanced(performed: Handsprings) -> None:
    assert performed.balanced[0]


def test_most_disturbed_ones_end_balanced(performed: Handsprings) -> None:
    assert np.mean(performed.balanced[2:]) >= 0.8


def test_turns_backwards_over_the_hands(performed: Handsprings) -> None:
    moments = [performed.liftoff[0], performed.hands[0], performed.release[0], performed.touchdown[0]]
    assert np.all(np.diff(moments) > 0.1)
    # The hands add momentum for the second half.
    assert performed.second[0] < performed.first[0] < -60.0


def test_failure_falls_backwards(performed: Handsprings) -> None:
    assert performed.fell_backwards[1]
    assert not performed.balanced[1]
    assert performed.feet[1] > performed.feet[0] + 0.2  # too far forward


def test_goes_through_all_its_rows(character: Gymnast, script: Script) -> None:
    performance = Performance(character, [script.table(character.body)], frame_rate=60)
    rows = performance.run(6.0, ["row"])["row"][:, 0]
    performance.close()
    assert [script.row_names[int(row)] for row in dict.fromkeys(rows)] == list(script.row_names)


def test_arms_that_turn_stay_mirror_images(character: Gymnast) -> None:
    arms = {
        "shoulder": 3.0,
        "shoulder_spread": 0.1,
        "shoulder_turn": 1.2,
        "elbow": 0.3,
        "forearm_turn": 0.4,
        "wrist": 1.4,
    }
    channels = {f"{side}_{name}": value for side in ("left", "right") for name, value in arms.items()}
    points = site_points(character.body, positions_of(character.body, channels))
    for left, right in zip(HAND_SITES["left"], HAND_SITES["right"], strict=True):
        np.testing.assert_allclose(points[left], points[right] * [1.0, -1.0, 1.0], atol=1e-9)


def test_strength_clips_servos() -> None:
    joints = JointForces.none(1)
    joints.servo(0, 0.0, 0.0, 2.0, 0.0, 100.0, 10.0, 0.001, (-30.0, 50.0))
    assert joints.tau[0] == 50.0
    assert joints.implicit[0] == 0.0  # a servo at its end does not give way
    free = JointForces.none(1)
    free.servo(0, 0.0, 0.0, 0.3, 0.0, 100.0, 10.0, 0.001, (-30.0, 50.0))
    assert free.tau[0] == pytest.approx(30.0)
    assert free.implicit[0] > 0.0


def test_servos_damp_alike_with_every_step_where_a_row_asks_for_it(character: Gymnast) -> None:
    script = parse_script(
        """
[parameters]
step_damping = 1.0

[[row]]
name = "point the toes"
duration = 0.05
channels = { ankle = 0.3 }
gains = { ankle = [4.45, 0.5] }
settings = { step_damping = "step_damping" }
""",
        "a script of one row",
    )
    swings = []
    for steps in (1200, 2400):
        people = airborne_population(character, {}, 2)
        settings = FidelitySettings(threads=1, steps_per_second=steps)
        values = [{"step_damping": 1.0}, {"step_damping": 0.0}]
        run = trials(character, script, values, settings, frame_rate=300, people=people)
        ankle = character.body.coordinate_names.index("left_ankle.2")
        swings.append(run.run(0.1, ["q"])["q"][:, :, ankle].max(axis=0))
        run.close()
    kept, taken_off = np.abs(swings[1] - swings[0])
    assert taken_off < 0.4 * kept


def test_strengths_are_those_of_a_trained_human() -> None:
    strong = gymnast("male", strength_limits=True)
    assert strong.strongest is not None
    knee = strong.strongest[speed_index(strong.body, "left_knee", "y")]
    np.testing.assert_allclose(knee, [-378.0, 193.0], rtol=0.02)  # it straightens more strongly than it bends
    assert gymnast("male").strongest is None
