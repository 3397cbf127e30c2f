"""The bicycle without hands: it rolls, balances itself where it should, falls where it should, and skids."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from echelon.agents.riders.bicycle import (
    FORK_LIMIT,
    FRONT_SPEED,
    REAR_SPEED,
    STEER,
    Bicycle,
    TyreParameters,
    benchmark_bicycle,
    bicycle_links,
    racing_bicycle,
    wheel_sites,
)
from echelon.agents.riders.bicycle_looks import crank_visuals
from echelon.agents.riders.coasting import roll
from echelon.agents.riders.whipple import linear_bicycle
from echelon.errors import InputError
from echelon.export.shapes import joined, rotation_matrix, visual_mesh
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.model import Model
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun


@cache
def benchmark() -> Bicycle:
    """One for all tests: programs are kept by character."""
    return Bicycle(benchmark_bicycle())


@cache
def racer() -> Bicycle:
    return Bicycle(racing_bicycle())


def open_ground() -> FlatTerrain:
    return FlatTerrain.of(WorldSettings(ground="plane", corral=None))


# ---- as data ---------------------------------------------------------------------------------------------------------
def test_the_linear_model_is_the_published_one() -> None:
    ideal = linear_bicycle(benchmark_bicycle())
    M = [[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]]
    C1 = [[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]]
    K0 = [[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]]
    K2 = [[0.0, 76.59734589573222], [0.0, 2.65431523794604]]
    for found, published in ((ideal.M, M), (ideal.C1, C1), (ideal.K0, K0), (ideal.K2, K2)):
        np.testing.assert_allclose(found, published, rtol=0.0, atol=2e-13)
    # Two rows of the paper's Table 2.
    assert np.real(ideal.eigenvalues(0.0)) == pytest.approx(
        [5.53094371765, 3.13164324791, -3.13164324791, -5.53094371765]
    )
    pair = ideal.eigenvalues(5.0)[1]
    assert pair == pytest.approx(complex(-0.77534188219585, 4.46486771378823), abs=1e-11)


def test_the_body_has_the_linear_models_mass_matrix() -> None:
    """Two ways from the same parameters: the tree's mass matrix under the wheels' constraints, and the closed form."""
    parameters = benchmark_bicycle()
    body = benchmark().body
    assert body.mass == pytest.approx(94.0)
    np.testing.assert_allclose(body.center_of_mass(body.q_reference), parameters.center_of_mass, atol=1e-12)
    # At rest, a unit rate of lean, and one of steer to the right with the yaw that keeps the front contact in place.
    lean, steer = (benchmark().rolling(0.0, lean_rate=a, steer_rate=b)[1] for a, b in ((1.0, 0.0), (0.0, -1.0)))
    rates = np.stack([lean, steer])
    matrix = rates @ body.mass_matrix(body.q_reference) @ rates.T
    np.testing.assert_allclose(matrix, linear_bicycle(parameters).M, rtol=1e-12)


def test_stands_on_its_wheels_and_steers_to_the_left() -> None:
    for parameters in (benchmark_bicycle(), racing_bicycle()):
        body = Body(name="bicycle", links=bicycle_links(parameters), contacts=wheel_sites(parameters))
        assert Model.from_dict(body.to_dict()) == Model.from_dict(Model.to_dict(body))
        poses = body.link_poses(body.q_reference)
        assert poses[2, :3] == pytest.approx([0.0, 0.0, parameters.rear_wheel.radius])
        assert poses[3, :3] == pytest.approx([parameters.wheelbase, 0.0, parameters.front_wheel.radius])
        turned = body.q_reference
        turned[STEER] = 0.3
        hub = body.link_poses(turned)[3]
        forward = 1.0 - 2.0 * (hub[4] ** 2 + hub[5] ** 2), 2.0 * (hub[3] * hub[4] + hub[5] * hub[6])
        assert math.atan2(forward[1], forward[0]) == pytest.approx(0.3 * math.cos(parameters.steer_tilt), rel=0.02)


def test_a_tyre_is_as_round_as_it_is_said_to_be() -> None:
    """The lowest point of a leaning wheel wanders to the side as that of a torus does."""
    site = wheel_sites(racing_bicycle())[0]
    r, b, _ = site.radii
    lean = math.radians(20.0)
    height = math.hypot(r * math.cos(lean), b * math.sin(lean))
    tyre = racing_bicycle().rear_wheel.tyre_radius
    assert height == pytest.approx((r - tyre) * math.cos(lean) + tyre, abs=2e-4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"wheelbase": 0.0}, "wheelbase is 0.0"),
        ({"steer_tilt": 18.0}, "steer_tilt is 18.0 rad"),
        ({"fork": replace(racing_bicycle().fork, mass=-1.0)}, "fork.mass is -1.0"),
    ],
)
def test_refuses_what_is_no_bicycle(change: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace(racing_bicycle(), **change)


def test_looks_like_a_bicycle() -> None:
    bicycle = benchmark()
    poses = bicycle.body.link_poses(bicycle.body.q_reference)
    points = []
    for link, pose in zip(bicycle.body.links, poses, strict=True):
        mesh = joined([visual_mesh(visual) for visual in link.visuals])
        assert len(mesh.triangles) < 2500, link.name
        points.append(mesh.points + pose[:3])
    every = np.concatenate(points)
    assert every[:, 2].min() == pytest.approx(0.0, abs=1e-3)
    assert every[:, 2].max() == pytest.approx(1.0, abs=0.1)
    assert every[:, 0].max() - every[:, 0].min() == pytest.approx(1.02 + 0.65, abs=0.02)
    assert np.ptp(every[:, 1]) == pytest.approx(2.0 * 0.22 + 0.03, abs=0.02)
    # Nothing but the pedals and bars is broad, and the wheels are empty between their spokes.
    rear = points[2] - poses[2, :3]
    distance = np.hypot(rear[:, 0], rear[:, 2])
    assert distance.max() == pytest.approx(0.3, abs=1e-3)
    assert len(crank_visuals(0.165, 0.11)) > 5


# ---- rolling ---------------------------------------------------------------------------------------------------------
def test_rolls_straight_without_slipping_and_keeps_its_energy() -> None:
    speeds = np.array([4.5, 5.0, 5.5, 6.0])
    coast = roll(benchmark(), *benchmark().rolling(speeds), seconds=10.0)
    parameters = benchmark_bicycle()
    assert coast.u[:, :, REAR_SPEED] * parameters.rear_wheel.radius == pytest.approx(coast.speed, rel=1e-5)
    assert coast.u[:, :, FRONT_SPEED] * parameters.front_wheel.radius == pytest.approx(coast.speed, rel=1e-5)
    assert coast.q[-1, :, 0] == pytest.approx(10.0 * speeds, rel=1e-4)
    assert np.abs(coast.q[:, :, 1]).max() < 1e-3
    assert coast.energy == pytest.approx(np.broadcast_to(coast.energy[0], coast.energy.shape), rel=1e-4)


def test_rolling_resistance_takes_what_it_should() -> None:
    """Both wheels' damping times their rates is the power that goes; on a racing bicycle nothing else takes any."""
    bicycle = racer()
    coast = roll(bicycle, *bicycle.rolling(np.array([7.0])), seconds=2.0)
    damping = bicycle.bicycle.rolling_resistance
    power = damping * (coast.u[:, 0, REAR_SPEED] ** 2 + coast.u[:, 0, FRONT_SPEED] ** 2)
    lost = np.trapezoid(power, coast.times)
    assert coast.energy[0, 0] - coast.energy[-1, 0] == pytest.approx(lost, rel=0.01)


def test_locked_wheels_skid_as_far_as_friction_allows() -> None:
    friction = 0.3
    locked = replace(benchmark_bicycle(), rolling_resistance=1e6, tyre=TyreParameters(friction=friction))
    bicycle = Bicycle(locked)
    q, u = bicycle.rolling(np.array([6.0, 3.0]))
    u[:, REAR_SPEED] = u[:, FRONT_SPEED] = 0.0
    coast = roll(bicycle, q, u, seconds=1.5)
    # It nods at first; then it slows evenly, whatever its speed.
    slowing = (coast.speed[40] - coast.speed[55]) / (coast.times[55] - coast.times[40])
    assert slowing == pytest.approx(friction * locked.gravity, rel=0.005)
    assert coast.speed[-10:, 1].max() < 0.01  # 3 m/s are gone after a second, and it stands
    assert coast.q[-1, 1, 0] == pytest.approx(3.0**2 / (2.0 * friction * locked.gravity), rel=0.05)


# ---- balance ---------------------------------------------------------------------------------------------------------
def pushed(bicycle: Bicycle, q: np.ndarray, u: np.ndarray, impulse: np.ndarray) -> np.ndarray:
    """Speeds after a sideways blow at the frames' centres of mass [N s], shape [bicycles, u_count]."""
    blow = np.zeros((len(impulse), 3))
    blow[:, 1] = impulse
    return u + bicycle.body.generalized_impulse(q, "frame", bicycle.body.links[0].com, blow)


def test_balances_itself_at_5_metres_a_second_and_nowhere_near_3() -> None:
    bicycle = benchmark()
    speeds = np.array([5.0, 5.0, 5.0, 3.0, 3.0])
    push = np.array([10.0, -10.0, 30.0, 10.0, -10.0])
    q, u = bicycle.rolling(speeds)
    coast = roll(bicycle, q, pushed(bicycle, q, u, push), seconds=9.0)
    # Pushed to the left where it is heavy, it leans to the left.
    early = coast.lean[:20]
    most = np.take_along_axis(early, np.abs(early).argmax(axis=0)[None], axis=0)[0]
    np.testing.assert_array_equal(np.sign(most), -np.sign(push))
    self_stable = speeds == 5.0
    assert np.abs(coast.lean[:, self_stable]).max() > math.radians(2.0)
    assert not coast.fallen[:, self_stable].any()
    assert np.abs(coast.lean[-1, self_stable]).max() < math.radians(0.3)
    assert coast.fallen[-1, ~self_stable].all()
    assert not coast.fallen[60, ~self_stable].any()  # not at once: it weaves before it falls


def test_turns_by_leaning_the_other_way_from_the_torque_on_its_bars() -> None:
    """Counter-steering: a push of the bars to the left leans it to the right, and so it goes to the right."""
    bicycle = benchmark()
    coast = roll(bicycle, *bicycle.rolling(np.array([5.5, 5.5])), seconds=1.5, steer_torque=np.array([1.0, -1.0]))
    assert coast.steer[6, 0] > 0.0 > coast.steer[6, 1]
    assert coast.lean[30, 0] > math.radians(1.0)
    assert coast.lean[30, 1] < -math.radians(1.0)
    assert coast.heading[-1, 0] < 0.0 < coast.heading[-1, 1]
    np.testing.assert_allclose(coast.lean[:, 0], -coast.lean[:, 1], atol=1e-4)


def test_at_rest_it_falls_over_and_lies_still() -> None:
    lean, steer = np.radians([1.0, -1.0, 10.0, -10.0]), np.array([0.0, 0.0, 0.2, 0.2])
    for bicycle in (benchmark(), racer()):
        q, u = bicycle.rolling(np.zeros(4), lean=lean, steer=steer)
        coast = roll(bicycle, q, u, seconds=9.0)
        assert coast.fallen[-1].all()
        assert np.isfinite(coast.q).all()
        assert np.abs(coast.lean[-1]).min() > math.radians(55.0)
        assert np.abs(coast.q[-60:, :, :3] - coast.q[-1, :, :3]).max() < 0.005
        assert np.abs(coast.u[-1, :, :6]).max() < 0.02
        # Ground and friction only take; the tyres held about a joule at the start.
        assert (coast.energy.max(axis=0) < coast.energy[0] + 2.0).all()
        assert (coast.energy[-1] < 0.25 * coast.energy[0]).all()
        # It lies on its side with its parts on the ground, not in it.
        sunk = [_lowest(bicycle, q) for q in coast.q[-1]]
        assert min(sunk) > -0.04
        assert max(sunk) < 0.0


def _lowest(bicycle: Bicycle, q: np.ndarray) -> float:
    """Height of what is lowest of its saddle, pedals, grips and tyres [m]."""
    poses = bicycle.body.link_poses(q)
    heights = []
    for site in bicycle.body.contacts:
        pose = poses[bicycle.body.link_index(site.link)]
        up = rotation_matrix(pose[3:])[2]  # in the link's axes
        heights.append(pose[2] + up @ np.array(site.position) - np.linalg.norm(np.array(site.radii) * up))
    return float(min(heights))


def test_a_fall_is_noticed_once_and_lets_go_of_the_bars() -> None:
    bicycle = benchmark()
    q, u = bicycle.rolling(np.zeros(2), lean=np.radians([20.0, 0.0]))
    engine = Engine(bicycle, 2, open_ground(), frame_rate=60, substeps=20, tick=20, threads=1)
    chunk = ChunkArrays.allocate(120, 2, bicycle)
    engine.bind(chunk)
    engine.set_q(q)
    engine.set_u(u)
    engine.set_command("steer_torque", np.array([5.0, 0.0]))
    for frame in range(120):
        engine.advance(frame)
    assert (chunk.events.numpy()[..., 0] >= 0).sum(axis=0).tolist() == [1, 0]
    fallen = chunk.fallen.numpy()[:, 0].astype(bool)
    assert fallen[-1]
    np.testing.assert_array_equal(chunk.phases.numpy()[1:, 0] == 1, fallen[:-1])
    lean, steer = chunk.measures.numpy()[-1, 0]
    assert lean == pytest.approx(bicycle.lean(engine.q.astype(float))[0], abs=0.01)
    assert abs(steer) < FORK_LIMIT + 0.2


# ---- the two computations --------------------------------------------------------------------------------------------
def test_lanes_roll_as_the_reference_does() -> None:
    bicycle = racer()
    q, u = bicycle.rolling(
        np.array([3.0, 6.0, 12.0]),
        lean=np.array([0.1, -0.2, 0.3]),
        steer=np.array([0.1, 0.05, -0.05]),
        lean_rate=np.array([0.2, 0.0, -0.5]),
        steer_rate=np.array([0.0, 1.0, 0.0]),
    )
    q, u = (np.asarray(values, dtype=np.float32).astype(float) for values in (q, u))
    torque = np.array([0.0, 2.0, -1.0])
    coast = roll(bicycle, q, u, seconds=1.0 / 60.0, steer_torque=torque)
    run = ReferenceRun(bicycle, q, u, step=1.0 / 1200.0, tick=20, command={"steer_torque": torque})
    run.frame(20)
    assert np.abs(coast.q[-1] - run.q).max() < 5e-6
    assert np.abs(coast.u[-1] - run.u).max() < 2e-3
    assert not coast.fallen.any()
    assert not run.state.memory["fallen"].any()


def test_starts_as_a_crowd_as_it_starts_alone() -> None:
    people = Bicycle(benchmark_bicycle(), start_speed=4.0).population(3, seed=1, variation=0.1, in_phase=False)
    q, u = benchmark().rolling(4.0)
    assert people.q.shape == (3, benchmark().body.q_count)
    np.testing.assert_array_equal(people.q, np.tile(q, (3, 1)))
    np.testing.assert_array_equal(people.u, np.tile(u, (3, 1)))
