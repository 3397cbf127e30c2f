"""The check before anything runs that explicit forces suit the step."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from engine_scenes import ball_body, body_named, diagonal, free_link, hopper

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels.emit import Target
from echelon.warp_kernels.model import Joint, Link, ModelError, Spring
from echelon.warp_kernels.program import Program
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.stability import CONTACT_LIMIT, SPRING_LIMIT, check_explicit_forces

STEP = 1.0 / 1200.0
USUAL_STEPS = (1.0 / 1200.0, 1.0 / 720.0)


def refusal(body: Body, step: float = STEP) -> str:
    with pytest.raises(ModelError) as caught:
        check_explicit_forces(body, step)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def proposed(message: str) -> tuple[float, float]:
    """(at most so much, a step of at most so many seconds) of a refusal."""
    most = re.search(r"would pass: at most ([\d.]+) N", message)
    step = re.search(r"a step of at most ([\d.]+) ms", message)
    assert most is not None
    assert step is not None
    return float(most[1]), 1e-3 * float(step[1])


def two_masses(stiffness: float, damping: float, rest_length: float = 0.0) -> Body:
    """Two and three kilograms that a spring joins at their centres: it moves 1.2 kg."""
    one = free_link(2.0, diagonal(0.02, 0.02, 0.02), ()).links[0]
    other = replace(one, name="other", mass=3.0, joint=Joint("other root", "free", position=(0.5, 0.0, 0.0)))
    spring = Spring("cord", "link", (0.0, 0.0, 0.0), "other", (0.0, 0.0, 0.0), stiffness, damping, rest_length)
    return Body(name="pair", links=(one, other), springs=(spring,))


@pytest.mark.parametrize("step", USUAL_STEPS)
def test_the_hopper_passes(step: float):
    check_explicit_forces(hopper().body, step)


@pytest.mark.parametrize("name", ["male", "female"])
def test_the_humans_pass_since_their_contacts_are_implicit(name: str):
    body = body_named(name)
    assert all(site.integration == "implicit" for site in body.contacts)
    check_explicit_forces(body, STEP)
    explicit = replace(body, contacts=tuple(replace(site, integration="explicit") for site in body.contacts))
    assert f"body '{name}', contact 'TIP_" in refusal(explicit)


@pytest.mark.parametrize("rest_length", [0.0, 0.5])
def test_a_spring_between_two_masses_moves_their_reduced_mass(rest_length: float):
    most_k, most_c = 1.2 * (SPRING_LIMIT / STEP) ** 2, 1.2 * SPRING_LIMIT / STEP
    check_explicit_forces(two_masses(0.999 * most_k, 0.999 * most_c, rest_length), STEP)
    message = refusal(two_masses(1.01 * most_k, 0.0, rest_length))
    assert "body 'pair', spring 'cord': stiffness" in message
    assert "effective mass of 1.2 kg" in message
    message = refusal(two_masses(0.0, 1.01 * most_c, rest_length))
    assert "body 'pair', spring 'cord': damping" in message
    assert "implicit" not in message  # there are no implicit springs to propose


def test_off_the_centre_a_spring_moves_less():
    """At the end of a rod across the spring's pull: 1/m + r^2/I."""
    rod = free_link(2.0, diagonal(0.1, 0.1, 0.1), ())
    spring = Spring("tie", None, (0.3, 0.0, 1.0), "link", (0.3, 0.0, 0.0), 1.0, 0.0, rest_length=0.1)
    mass = 1.0 / (1.0 / 2.0 + 0.3**2 / 0.1)
    most = mass * (SPRING_LIMIT / STEP) ** 2
    check_explicit_forces(replace(rod, springs=(replace(spring, stiffness=0.999 * most),)), STEP)
    assert f"effective mass of {mass:.4g} kg" in refusal(
        replace(rod, springs=(replace(spring, stiffness=1.01 * most),))
    )
    # Along the rod it would move all of it; a bushing resists both, and the least counts.
    along = replace(spring, position_a=(2.0, 0.0, 0.0), stiffness=1.01 * most)
    check_explicit_forces(replace(rod, springs=(along,)), STEP)
    assert "effective mass" in refusal(replace(rod, springs=(replace(along, rest_length=0.0),)))


def test_what_is_proposed_passes_and_little_more_does_not():
    for body in (two_masses(1e6, 10.0), two_masses(10.0, 1e4), two_masses(1e6, 1e4)):
        message = refusal(body)
        most, step = proposed(message)
        check_explicit_forces(body, step)
        refusal(body, 1.02 * step)
        kind = "stiffness" if "stiffness" in message.partition(" is too much")[0] else "damping"
        gentler = replace(body.springs[0], **{kind: most})
        other = "damping" if kind == "stiffness" else "stiffness"
        check_explicit_forces(replace(body, springs=(replace(gentler, **{other: 0.0}),)), STEP)
        refusal(replace(body, springs=(replace(gentler, **{kind: 1.03 * most}),)))


def test_the_worst_of_several_is_named():
    body = two_masses(1.4e6, 0.0)
    worse = replace(body.springs[0], name="worse", stiffness=5e6)
    assert "spring 'worse'" in refusal(replace(body, springs=(body.springs[0], worse)))
    assert "spring 'worse'" in refusal(replace(body, springs=(worse, body.springs[0])))


def test_explicit_contacts_are_held_to_their_own_limit():
    """Normal: the ball's mass. Tangential: 2/7 of it, since it rolls. Patch: its moment of inertia."""
    mass, radius = 3.0, 0.2
    ratio = CONTACT_LIMIT / STEP
    gentle = {"stiffness": 100.0, "damping": 1.0, "tangential_stiffness": 100.0, "tangential_damping": 1.0}

    def explicit(**site: float) -> Body:
        return ball_body(radius, mass, **{**gentle, **site}, integration="explicit")

    for key, most, words in (
        ("stiffness", mass * ratio**2, "contact 'skin': stiffness"),
        ("damping", mass * ratio, "contact 'skin': damping"),
        ("tangential_stiffness", 2.0 / 7.0 * mass * ratio**2, "contact 'skin', tangential: stiffness"),
        ("tangential_damping", 2.0 / 7.0 * mass * ratio, "contact 'skin', tangential: damping"),
    ):
        check_explicit_forces(explicit(**{key: 0.999 * most}), STEP)
        message = refusal(explicit(**{key: 1.01 * most}))
        assert words in message
        assert message.endswith('or integration = "implicit"')
        implicit = ball_body(radius, mass, **{**gentle, key: 100.0 * most})
        check_explicit_forces(implicit, STEP)
    inertia, patch = 0.4 * mass * radius**2, 0.5
    most = inertia * ratio / patch**2
    check_explicit_forces(explicit(tangential_damping=0.999 * most, patch_radius=patch), STEP)
    message = refusal(explicit(tangential_damping=1.01 * most, patch_radius=patch))
    assert "contact 'skin', patch: damping" in message
    assert f"an inertia of {inertia:.4g} kg m^2" in message
    assert "N m s/rad" in message
    # Without friction there is nothing tangential to check.
    check_explicit_forces(explicit(tangential_damping=1e9, friction=0.0), STEP)


def test_walls_are_checked_sideways():
    body = ball_body(0.2, 3.0, surface="wall", stiffness=100.0, damping=1.01 * 3.0 * CONTACT_LIMIT / STEP)
    explicit = replace(body, contacts=(replace(body.contacts[0], integration="explicit", tangential_stiffness=0.0),))
    assert "contact 'skin': damping" in refusal(explicit)


def test_joints_count_as_loose():
    """A light hand on a hinge: the spring moves little more than the hand."""
    arm = free_link(50.0, diagonal(2.0, 2.0, 2.0), ()).links[0]
    hinge = Joint("wrist", "pin", position=(0.5, 0.0, 0.0), axes=((0.0, 1.0, 0.0),))
    hand = Link("hand", "link", hinge, 0.4, com=(0.1, 0.0, 0.0), inertia=diagonal(1e-4, 1e-4, 1e-4))
    spring = Spring("grip", "hand", (0.1, 0.0, 0.0), None, (0.6, 0.0, 0.0), 1e5, 100.0)
    body = Body(name="arm", links=(arm, hand), springs=(spring,))
    message = refusal(replace(body, springs=(replace(spring, damping=1e5),)))
    found = re.search(r"effective mass of ([\d.]+) kg", message)
    assert found is not None
    # Up and down, about the hinge: I / r^2.
    assert float(found[1]) == pytest.approx((1e-4 + 0.4 * 0.1**2) / 0.1**2, rel=0.02)


def test_a_program_refuses_what_would_shake_and_runge_kutta_is_left_to_its_user():
    character = ServoedBody(two_masses(1e7, 0.0), 0.0, 0.0)
    with pytest.raises(ModelError, match="spring 'cord'"):
        Program(character, STEP, 5 * STEP, "semi-implicit", Target(1))
    assert Program(character, STEP, 5 * STEP, "rk4", Target(1)).substep_operations > 0


def test_a_body_without_explicit_forces_is_not_even_asked_for_its_mass_matrix(monkeypatch: pytest.MonkeyPatch):
    def never(*_: np.ndarray) -> np.ndarray:
        raise AssertionError

    monkeypatch.setattr(Body, "mass_matrix", never)
    check_explicit_forces(body_named("mixed"), STEP)
