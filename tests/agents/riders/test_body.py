"""Riders as bodies: the papers' segments and freedoms, sizes that fit, limbs that reach, laws by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.riders.bicycle import racing_bicycle
from echelon.agents.riders.body import CRANK, PELVIS, RiderParameters, cyclist_model, fitted_bicycle
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.riders.limbs import ArmReach, leg_pose
from echelon.agents.riders.pedalling import PEAK_TIME, available_power, reserve_after, right_share, wanted_torque
from echelon.agents.riders.steering import (
    GAINS,
    Attitude,
    heading_fork,
    pursuit_fork,
    scheduled_gains,
    wanted_curvature,
)
from echelon.errors import InputError
from echelon.warp_kernels.model import AXIS_COUNT, Model
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.stability import check_explicit_forces

BICYCLE_LINKS = ("frame", "fork", "rear_wheel", "front_wheel", CRANK)


def _rider_links(model: Model) -> list:
    return [link for link in model.links if link.name not in BICYCLE_LINKS]


@pytest.mark.parametrize(("fifteen_segments", "segments", "freedoms"), [(False, 12, 17), (True, 15, 22)])
def test_has_the_papers_segments_freedoms_and_mass(fifteen_segments: bool, segments: int, freedoms: int) -> None:
    model = cyclist_model(RiderParameters(), racing_bicycle(), fifteen_segments=fifteen_segments)
    rider = _rider_links(model)
    assert len(rider) == segments
    controlled = sum(AXIS_COUNT[link.joint.kind] for link in rider if link.name != PELVIS)
    assert controlled == freedoms
    assert sum(link.mass for link in rider) == pytest.approx(87.69, abs=1e-6)
    assert model.mass == pytest.approx(97.69, abs=1e-6)
    # What was taken out of trunk and arms for head and hands is a body still.
    for link in rider:
        x, y, z = np.sort(np.linalg.eigvalsh(np.array(link.inertia)))
        assert x > 0.0
        assert x + y > 0.95 * z


def test_sits_where_the_prototype_sat() -> None:
    cyclist = Cyclist()
    zero = np.zeros(1)
    q, _ = cyclist.riding(zero, zero + 5.0, zero, zero + 1.0, zero + 2.0)
    x, y, z = cyclist.body.center_of_mass(q)[0]
    assert (x, y, z) == pytest.approx((0.452, 0.0, 1.02), abs=0.015)


def test_explicit_springs_suit_the_step() -> None:
    for fifteen_segments in (False, True):
        cyclist = Cyclist(fifteen_segments=fifteen_segments)
        check_explicit_forces(cyclist.body, 1.0 / cyclist.steps_per_second)


@pytest.mark.parametrize("stature", [0.85, 1.0, 1.12])
def test_a_rider_of_any_size_reaches_bars_and_pedals(stature: float) -> None:
    rider = RiderParameters().scaled(stature=stature, mass=stature**3)
    bicycle = fitted_bicycle(racing_bicycle(), stature)
    cyclist = Cyclist(rider, bicycle)
    assert rider.mass == pytest.approx(87.69 * stature**3)
    crank = np.linspace(-3.0, 3.0, 7)
    flat = np.zeros(7)
    q, _ = cyclist.riding(flat, flat + 5.0, flat, crank, flat + 2.0)
    poses = cyclist.body.link_poses(q)
    for spring in cyclist.body.springs:
        ends = [
            _point(cyclist.body, poses, link, place)
            for link, place in ((spring.link_a, spring.position_a), (spring.link_b, spring.position_b))
        ]
        assert np.abs(ends[1] - ends[0]).max() < 1e-9, spring.name


def _point(body: Body, poses: np.ndarray, link: str | None, place: tuple[float, float, float]) -> np.ndarray:
    assert link is not None
    pose = poses[:, body.link_index(link)]
    v = pose[:, 3:6]
    turn = 2.0 * np.cross(v, np.broadcast_to(place, v.shape))
    return pose[:, :3] + place + pose[:, 6:] * turn + np.cross(v, turn)


def test_refuses_a_rider_who_is_no_person() -> None:
    with pytest.raises(InputError, match=r"^rider: stature is 2\.0 times the usual, must lie between 0\.5 and 1\.5$"):
        RiderParameters().scaled(stature=2.0)


def test_arms_reach_bars_that_are_turned() -> None:
    rider, bicycle = RiderParameters(), racing_bicycle()
    cyclist = Cyclist(rider, bicycle)
    arms = ArmReach(rider, bicycle)
    steer = np.linspace(-0.5, 0.5, 11)
    flat = np.zeros(11)
    q, _ = cyclist.riding(flat, flat + 5.0, flat, flat, flat + 2.0)
    q[:, 7] = steer
    for side, sign in (("left", 1.0), ("right", -1.0)):
        names = [f"{side}_elbow", *(f"{side}_shoulder.{i}" for i in (1, 2, 3))]
        for name, value in zip(names, arms.angles(sign, np.sin(steer), np.cos(steer)), strict=True):
            q[:, cyclist.body.coordinate_names.index(name)] = value
    poses = cyclist.body.link_poses(q)
    for spring in cyclist.body.springs[:2]:
        hand = _point(cyclist.body, poses, spring.link_a, spring.position_a)
        grip = _point(cyclist.body, poses, spring.link_b, spring.position_b)
        assert np.abs(hand - grip).max() < 1e-9


def test_knees_bend_the_way_knees_bend() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    pose = leg_pose(RiderParameters(), racing_bicycle(), np.sin(angle), np.cos(angle), 0.61)
    assert pose.knee.min() > 0.5
    assert pose.hip.min() > 0.0


def test_gains_follow_the_table() -> None:
    for speed, *gains in GAINS:
        assert scheduled_gains(np.array(speed)) == pytest.approx(gains, rel=1e-6)
    between = scheduled_gains(np.array(4.5))
    assert between[0] == pytest.approx(0.5 * (1.19 + 0.88))
    assert scheduled_gains(np.array(-1.0))[0] == GAINS[0][1]
    assert scheduled_gains(np.array(90.0))[0] == pytest.approx(GAINS[-1][1])


def _upright(speed: float) -> Attitude:
    still = np.array(0.0)
    return Attitude(np.array(speed), still, still, still, (np.array(1.0), still))


def test_the_law_has_the_papers_signs() -> None:
    upright = _upright(6.0)
    one, none = np.array(1.0), np.array(0.0)
    assert heading_fork(upright, none, one) < 0.0  # to go left, right first
    leaning = Attitude(upright.speed, np.array(0.1), none, none, upright.ahead)
    assert heading_fork(leaning, one, none) < 0.0  # leaning right, steer right
    fork, lean = pursuit_fork(upright, np.array(0.02), racing_bicycle())
    assert fork < 0.0
    assert lean == pytest.approx(-np.arctan(36.0 * 0.02 / 9.80665))


def test_a_point_on_a_circle_asks_for_that_circle() -> None:
    for curvature in (0.0, 0.02, -0.05):
        for speed in (4.0, 8.0):
            attitude = _upright(speed)
            length = 1.5 * speed
            angle = np.arcsin(0.5 * curvature * length)
            found = wanted_curvature(
                attitude, np.cos(angle), np.sin(angle), np.array(length), np.array(curvature), np.array(0.6)
            )
            assert found == pytest.approx(curvature, abs=2e-5)


def test_torque_is_bounded_by_power_and_shared_by_the_legs() -> None:
    assert wanted_torque(np.array(5.0), 3.0, np.array(8.0), 300.0, 0.335, False) == pytest.approx(300.0 / 8.0)
    assert wanted_torque(np.array(-5.0), 3.0, np.array(8.0), 300.0, 0.335, False) == -60.0
    assert wanted_torque(np.array(-5.0), 3.0, np.array(8.0), 300.0, 0.335, True) == 0.0
    assert right_share(np.array(10.0), np.array(1.0)) == 1.0  # the right crank forward: the right leg pushes
    assert right_share(np.array(-10.0), np.array(1.0)) == 0.0


def test_the_reserve_lasts_a_minute_at_the_peak() -> None:
    reserve, tick, seconds = PEAK_TIME * 250.0, 0.1, 0.0
    while available_power(np.array(reserve), 300.0, 550.0) >= 549.0:
        reserve = float(reserve_after(np.array(reserve), np.array(550.0), 300.0, 550.0, tick))
        seconds += tick
    assert 50.0 < seconds < 60.0
    assert available_power(np.array(0.0), 300.0, 550.0) == 300.0
    assert reserve_after(np.array(0.0), np.array(100.0), 300.0, 550.0, 1.0) == pytest.approx(100.0)
