"""Two bodies that meet, each computed beside the other's ghost: impulses, energy, restitution; in float64."""

from __future__ import annotations

import numpy as np
import pytest
from free_bodies import STEP, FreeBody, at, meet_in_space, rod

from echelon.warp_kernels.bumper import bumper_of
from echelon.warp_kernels.crossing import segment_distances
from echelon.warp_kernels.meeting import SHOVE_SPEED, closest_points
from echelon.warp_kernels.restitution import restitution_damping

RESTITUTIONS = (0.0, 0.3, 0.7, 1.0)
GAPS = (0.02, 0.06, 0.095)  # some touch in the middle of a frame, some across the end of one


def every_case() -> tuple[np.ndarray, np.ndarray]:
    """Each restitution with each gap."""
    wanted, gaps = np.meshgrid(RESTITUTIONS, GAPS, indexing="ij")
    return wanted.ravel(), gaps.ravel()


def pair_of_balls(ratio: float) -> tuple[FreeBody, FreeBody]:
    """Two balls of one size, the first so many times as heavy."""
    return FreeBody(10.0 * ratio, (0.4 * ratio, 0.4 * ratio, 0.4 * ratio)), FreeBody(10.0)


# ---- head-on and glancing --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("ratio", [1.0, 6.0])
def test_a_head_on_collision_returns_what_was_asked_for_and_gains_nothing(ratio: float):
    wanted, gaps = every_case()
    count, still = len(gaps), np.zeros(len(gaps))
    first = at(np.zeros((count, 3)), np.tile([2.0, 0.0, 0.0], (count, 1)))
    second = at(np.column_stack([0.5 + gaps, still, still]), np.tile([-1.0, 0.0, 0.0], (count, 1)))
    met = meet_in_space(pair_of_balls(ratio), (first[0], second[0]), (first[1], second[1]), restitution=wanted)
    parting = met.u[1][-1][:, 0] - met.u[0][-1][:, 0]
    assert np.abs(parting / 3.0 - wanted).max() < 0.08
    both = met.impulse(0) + met.impulse(1)
    assert np.abs(both).max() < 1e-3 * np.abs(met.impulse(0)[:, 0]).min()
    assert np.all(met.energy <= met.energy[0] * (1.0 + 1e-9))


@pytest.mark.parametrize("ratio", [1.0, 6.0])
def test_glancing_and_spinning_bodies_feel_the_same_impulse(ratio: float):
    wanted, gaps = every_case()
    count = len(gaps)
    rng = np.random.default_rng(5)
    aside = rng.uniform(0.15, 0.35, size=count) * rng.choice([-1.0, 1.0], size=count)
    first = at(np.zeros((count, 3)), np.tile([2.0, 0.0, 0.0], (count, 1)), rng.normal(size=(count, 3)) * 8.0)
    second = at(
        np.column_stack([0.44 + gaps, aside, 0.1 * aside]),
        np.tile([-1.0, 0.0, 0.0], (count, 1)),
        rng.normal(size=(count, 3)) * 8.0,
    )
    met = meet_in_space(pair_of_balls(ratio), (first[0], second[0]), (first[1], second[1]), restitution=wanted)
    got = np.linalg.norm(met.impulse(0), axis=-1)
    assert np.all(got > 1.0)
    assert np.all(np.linalg.norm(met.impulse(0) + met.impulse(1), axis=-1) < 0.01 * got)
    assert np.all(met.energy <= met.energy[0] * 1.01)


@pytest.mark.parametrize("ratio", [1.0, 6.0])
@pytest.mark.parametrize("parallel", [False, True])
def test_spinning_rods_that_are_struck_anywhere_feel_the_same_impulse(ratio: float, parallel: bool):
    wanted, gaps = every_case()
    count = len(gaps)
    rng = np.random.default_rng(7)
    if parallel:
        first = at(np.zeros((count, 3)), np.tile([0.0, 1.0, 0.0], (count, 1)))
        second = at(np.column_stack([5.0 * gaps, 0.3 + gaps, 0.0 * gaps]), np.tile([0.0, -0.5, 0.0], (count, 1)))
    else:
        first = at(
            np.zeros((count, 3)),
            np.tile([1.0, 0.0, 0.0], (count, 1)),
            rng.normal(size=(count, 3)) * (2.0, 3.0, 3.0),
            rng.uniform(-3.0, 3.0, size=count),
        )
        second = at(
            np.column_stack([0.95 + gaps, rng.uniform(-0.2, 0.2, count), rng.uniform(-0.1, 0.1, count)]),
            np.tile([-2.0, 0.0, 0.0], (count, 1)),
            rng.normal(size=(count, 3)) * (2.0, 3.0, 3.0),
            rng.uniform(-3.0, 3.0, size=count),
        )
    bodies = rod(10.0 * ratio), rod(10.0)
    met = meet_in_space(bodies, (first[0], second[0]), (first[1], second[1]), restitution=wanted, frames=10)
    got = np.linalg.norm(met.impulse(0), axis=-1)
    struck = got > 1.0
    assert np.count_nonzero(struck) > count // 2
    apart = np.linalg.norm(met.impulse(0) + met.impulse(1), axis=-1)
    assert np.all(apart[struck] < 0.02 * got[struck])
    assert np.all(met.energy <= met.energy[0] * 1.01)


def test_who_overlaps_from_the_start_is_pushed_apart_and_not_shot():
    places = np.array([[0.3, 0.0, 0.0], [0.1, 0.05, 0.0], [0.45, 0.0, 0.0]])
    first, second = at(np.zeros((3, 3)), np.zeros((3, 3))), at(places, np.zeros((3, 3)))
    met = meet_in_space(pair_of_balls(1.0), (first[0], second[0]), (first[1], second[1]), frames=60)
    speed = np.linalg.norm(met.u[1][-1][:, :3] - met.u[0][-1][:, :3], axis=-1)
    apart = np.linalg.norm(met.q[1][-1][:, :3] - met.q[0][-1][:, :3], axis=-1)
    assert np.all(apart > 0.5)
    assert np.all(speed < 1.1 * SHOVE_SPEED)


# ---- parts -----------------------------------------------------------------------------------------------------------
def test_the_damping_of_a_restitution_is_that_of_the_formula_where_steps_are_short():
    for wanted in (0.2, 0.4, 0.6, 0.8, 0.95):
        zeta = restitution_damping(wanted, 0.01)
        root = np.sqrt(1.0 - zeta * zeta)
        # Schwager and Poschel 2007: the contact ends when the force does, before the spring is straight again.
        until = np.arctan2(2.0 * zeta * root, 2.0 * zeta * zeta - 1.0)
        assert np.exp(-zeta / root * until) == pytest.approx(wanted, abs=0.01)


def test_closest_points_are_as_close_as_any_and_both_sides_find_the_same():
    rng = np.random.default_rng(11)
    start, end, other_start, other_end = (list(rng.normal(size=(3, 500))) for _ in range(4))
    along, other_along = (
        [b - a for a, b in zip(*both, strict=True)] for both in ((start, end), (other_start, other_end))
    )
    s, t, barrel = closest_points(start, along, other_start, other_along)
    p = np.array([a + s * b for a, b in zip(start, along, strict=True)])
    r = np.array([a + t * b for a, b in zip(other_start, other_along, strict=True)])
    found = np.linalg.norm(p - r, axis=0)
    ends = (np.array(x).T for x in (start, end, other_start, other_end))
    least = segment_distances(*ends)
    assert np.all(found >= least - 1e-9)
    # Distance with what makes barrels of capsules: thinner, never by more than a few hundredths of their length.
    assert np.all(np.sqrt(found**2 + barrel) >= least - 1e-9)
    size = np.linalg.norm(along, axis=0) + np.linalg.norm(other_along, axis=0)
    assert np.all(found - least < 0.05 * size)
    t_back, s_back, barrel_back = closest_points(other_start, other_along, start, along)
    assert np.allclose(s_back, s, atol=1e-9)
    assert np.allclose(t_back, t, atol=1e-9)
    assert np.allclose(barrel_back, barrel, atol=1e-12)


def test_parallel_axes_touch_in_the_middle_of_where_they_overlap():
    s, t, _ = closest_points([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.6, 0.3, 0.0], [1.0, 1e-9, 0.0])
    assert s == pytest.approx(0.8, abs=0.01)
    assert t == pytest.approx(0.2, abs=0.01)


def test_the_apparent_mobility_of_a_rigid_body_is_its_inverse_inertia():
    body = FreeBody(8.0, (0.2, 0.4, 0.5), center=(0.1, -0.05, 0.2))
    bumper = bumper_of(body, STEP)
    assert bumper is not None
    assert np.allclose(bumper.center, (0.1, -0.05, 0.2))
    expected = np.diag([1 / 8.0] * 3 + [1 / 0.2, 1 / 0.4, 1 / 0.5])
    assert np.allclose(bumper.mobility, expected, atol=0.02 * 5.0)
    assert np.allclose(np.diag(bumper.mobility), np.diag(expected), rtol=0.01)
