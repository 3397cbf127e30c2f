"""The back handspring that ships: over the hands onto the feet, balanced also when disturbed; and its failure falls."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.gymnasts.body import HAND_SITES
from echelon.agents.gymnasts.gymnast import GAINS, Gymnast, gymnast
from echelon.agents.gymnasts.joints import speed_index
from echelon.agents.gymnasts.posture import positions_of
from echelon.agents.gymnasts.script import Script, load_script
from echelon.agents.gymnasts.standing import site_points
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.handspring import FAILURE, Handsprings, perform
from echelon.benchmarks.thesis.trials import gymnast_of
from echelon.simulation.performance import Performance
from echelon.warp_kernels.articulated import ContactLoad
from echelon.warp_kernels.character import View
from echelon.warp_kernels.contact import NO_MATRIX, Contact, JointForces
from echelon.warp_kernels.kinematics import kinematics

DISTURBED = 38
NOTHING = ContactLoad([0.0] * 3, [0.0] * 3, NO_MATRIX, NO_MATRIX, NO_MATRIX)


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


@pytest.mark.parametrize("kept", [1.0, 0.0])
def test_what_a_step_damps_is_taken_off_where_a_row_asks_for_it(character: Gymnast, kept: float) -> None:
    body, h = character.body, 1.0 / 1200.0
    q, u = body.q_reference.tolist(), [0.0] * body.u_count
    view = View(
        q=q,
        u=u,
        kin=kinematics(body.tree, q, u),
        memory={**character.memory, "kp.ankle": 4.45, "row.step_damping": kept},
        parameters=dict(character.parameters),
        command={},
        substep=0.0,
        step=h,
        tick=4.0 * h,
        implicit_step=h,
        contacts={site.name: Contact(NOTHING, 0.0, 0.0, [], []) for site in body.contacts},
    )
    joints = JointForces.none(body.u_count)
    character.actuate(view, joints)
    ankle, (kp, kv) = speed_index(body, "left_ankle", "y"), GAINS["ankle"]
    assert joints.implicit[ankle] == pytest.approx(h * (kv + kept * h * 4.45 * kp))


def test_every_row_of_the_handspring_takes_it_off(script: Script) -> None:
    assert {row["settings"]["step_damping"] for row in script.rows} == {0}


def test_strengths_are_those_of_a_trained_human() -> None:
    strong = gymnast("male", strength_limits=True)
    assert strong.strongest is not None
    knee = strong.strongest[speed_index(strong.body, "left_knee", "y")]
    np.testing.assert_allclose(knee, [-378.0, 193.0], rtol=0.02)  # it straightens more strongly than it bends
    assert gymnast("male").strongest is None
