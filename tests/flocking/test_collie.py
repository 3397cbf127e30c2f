"""The collie: a bicycle with its limits, waypoints, and the dog that pens a herd of point robots."""

from __future__ import annotations

import math

import numpy as np
import pytest
import warp as wp

from echelon.flocking.collie import Collie
from echelon.scenario import CollieSettings, CorralSettings, CrowdSettings, HerdSettings, Scenario, WorldSettings
from tests.flocking.point_robots import GroupRun

FRAME_RATE = 30
OPEN = WorldSettings(ground="plane")


class Ride:
    """A bicycle whose commands the test gives."""

    def __init__(self, settings: CollieSettings, world: WorldSettings = OPEN) -> None:
        self.collie = Collie(settings, HerdSettings(), world, 16, frame_rate=FRAME_RATE, device="cpu")
        self.bicycle = self.collie.arrays.bicycle

    def go(self, speed: float, steering: float, frames: int) -> np.ndarray:
        """Follow one command; rows (x, y, heading, speed, steering) after each frame."""
        self.collie.arrays.command.assign(np.array([[speed, steering]], dtype=np.float32))
        rows = []
        for _ in range(frames):
            self.collie.enqueue_ride()
            place = self.bicycle.place.numpy()[0]
            state = (self.bicycle.heading, self.bicycle.speed, self.bicycle.steering)
            rows.append([*place, *(float(array.numpy()[0]) for array in state)])
        return np.array(rows)


# ---- the bicycle -----------------------------------------------------------------------------------------------------
def test_it_speeds_up_and_brakes_within_its_limits_and_never_reverses() -> None:
    ride = Ride(CollieSettings(start=(0.0, 0.0), max_acceleration=2.0, max_speed=6.0))
    fast = ride.go(20.0, 0.0, 150)
    assert np.diff(fast[:, 3]).max() <= 2.0 / FRAME_RATE + 1e-6
    assert fast[-1, 3] == pytest.approx(6.0)
    slow = ride.go(-5.0, 0.0, 90)
    assert np.diff(slow[:, 3]).min() >= -3.0 / FRAME_RATE - 1e-5
    assert slow[-1, 3] == 0.0
    assert np.diff(slow[:, 0]).min() >= 0.0
    np.testing.assert_array_equal(slow[:, 1], 0.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_its_tightest_turn_is_a_circle_of_the_turning_radius(side: float) -> None:
    ride = Ride(CollieSettings(start=(0.0, 0.0), turning_radius=3.0, wheelbase=1.1))
    ride.go(2.0, side, 60)  # up to speed, at full lock
    frames = round(2.0 * math.pi * 3.0 / 2.0 * FRAME_RATE)
    path = ride.go(2.0, side, frames)
    assert np.ptp(path[:, 4]) < 1e-6
    heading = path[:, 2]
    rear = path[:, :2] - 0.55 * np.column_stack([np.cos(heading), np.sin(heading)])
    center = 0.5 * (rear.max(axis=0) + rear.min(axis=0))
    np.testing.assert_allclose(np.linalg.norm(rear - center, axis=1), 3.0, rtol=5e-3)
    assert np.unwrap(heading)[-1] - heading[0] == pytest.approx(side * 2.0 * math.pi, rel=0.02)


def test_at_speed_it_turns_more_widely_and_leans_into_the_bend() -> None:
    ride = Ride(CollieSettings(start=(0.0, 0.0), max_speed=6.0))
    path = ride.go(6.0, 1.0, 300)
    rate = float(np.diff(np.unwrap(path[-30:, 2])).mean()) * FRAME_RATE
    assert 6.0 * rate == pytest.approx(4.0, rel=0.01), "sideways acceleration"
    x, y, z, w = ride.collie.arrays.pose.numpy()[0][3:]
    up = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    left = np.array([-math.sin(path[-1, 2]), math.cos(path[-1, 2])])
    assert float(up[:2] @ left) == pytest.approx(math.sin(math.atan(4.0 / 9.80665)), rel=0.01)
    assert math.hypot(x, y, z, w) == pytest.approx(1.0, abs=1e-6)


def test_steering_takes_time() -> None:
    ride = Ride(CollieSettings(start=(0.0, 0.0), steering_rate=2.0))
    ride.go(2.0, 0.0, 60)
    turned = ride.go(2.0, 0.3, 3)[:, 4]
    np.testing.assert_allclose(turned, np.array([1, 2, 3]) * 2.0 / FRAME_RATE, rtol=1e-5)


def test_a_fence_stops_it_and_turns_it_alongside() -> None:
    ride = Ride(CollieSettings(start=(0.0, 20.0), heading=1.2), WorldSettings())
    path = ride.go(6.0, 0.0, 600)
    room = 28.0 - np.hypot(np.maximum(np.abs(path[:, 0]) - 17.0, 0.0), path[:, 1])
    assert room.min() > 0.5, "the middle of the bicycle stays inside of the fence"
    assert path[-1, 3] > 1.0, "it has not been caught by it"
    ahead = Ride(CollieSettings(start=(0.0, 20.0), heading=math.pi / 2), WorldSettings()).go(6.0, 0.0, 120)
    assert ahead[:, 1].max() < 28.0 - 0.5


@pytest.mark.parametrize("heading", [0.0, 0.5, -0.6])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_is_steered_out_of_a_corner_of_the_corral(heading: float, side: float) -> None:
    corral = CorralSettings(center=(25.0, 0.0), size=10.0, opening=8.0, facing=(-1.0, 0.0))
    ride = Ride(CollieSettings(start=(15.0, 0.0), heading=heading), WorldSettings(corral=corral))
    caught = ride.go(4.0, 0.0, 600)[-1]
    assert caught[3] < 0.1, "straight ahead it stays where two fences meet"
    away = ride.go(4.0, side * math.radians(20.0), 150)
    assert away[:, 3].max() > 1.0
    assert np.linalg.norm(away[:, :2] - caught[:2], axis=1).max() > 2.0


def test_the_herd_sees_where_it_is_and_how_it_moves() -> None:
    ride = Ride(CollieSettings(start=(1.0, 2.0), heading=0.5, start_speed=3.0))
    np.testing.assert_allclose(
        ride.collie.arrays.user.numpy()[0], [1.0, 2.0, 3.0 * math.cos(0.5), 3.0 * math.sin(0.5)], rtol=1e-6
    )
    path = ride.go(3.0, 0.0, 10)
    np.testing.assert_allclose(ride.collie.arrays.user.numpy()[0, :2], path[-1, :2], rtol=1e-6)
    np.testing.assert_allclose(ride.collie.arrays.pose.numpy()[0, :3], [*path[-1, :2], 0.0], rtol=1e-6)


# ---- waypoints -------------------------------------------------------------------------------------------------------
def ridden(settings: CollieSettings, seconds: float) -> np.ndarray:
    """Places frame by frame [m], from frame 0."""
    scenario = Scenario(
        name="test",
        crowd=CrowdSettings(count=1, start_center=(0.0, 500.0)),
        world=WorldSettings(ground="plane", half_length=1000.0, half_width=1000.0),
        collie=settings,
    )
    run = GroupRun(scenario)
    collie = run.group.collie
    assert collie is not None
    places = []
    for _ in range(round(seconds * FRAME_RATE)):
        places.append(collie.arrays.bicycle.place.numpy()[0].copy())
        run.want()
    return np.array(places)


def test_waypoints_are_passed_in_time() -> None:
    waypoints = ((4.0, 10.0, 0.0), (9.0, 30.0, 5.0), (15.0, 35.0, 25.0), (18.0, 35.0, 25.0))
    places = ridden(CollieSettings(driver="waypoints", start=(0.0, 0.0), waypoints=waypoints), 25.0)
    for time, x, y in waypoints:
        off = np.linalg.norm(places[round(time * FRAME_RATE)] - (x, y))
        assert off < 2.0, f"{off:.2f} m away at {time:g} s"
    assert np.linalg.norm(places[-1] - (35.0, 25.0)) < 1.0
    assert np.linalg.norm(places[-1] - places[-FRAME_RATE]) < 0.05, "it waits at the last"


def test_an_early_rider_takes_its_time_to_the_first_waypoint() -> None:
    places = ridden(CollieSettings(driver="waypoints", start=(0.0, 0.0), waypoints=((20.0, 20.0, 0.0),)), 22.0)
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) * FRAME_RATE
    assert speeds[150:450].max() < 1.6
    assert np.linalg.norm(places[-1] - (20.0, 0.0)) < 1.0


# ---- the dog ---------------------------------------------------------------------------------------------------------
def penning_scenario(
    seed: int,
    *,
    herd_at: tuple[float, float] = (-8.0, 0.0),
    dog_at: tuple[float, float] = (-38.0, 0.0),
    corral_at: tuple[float, float] = (38.0, 0.0),
    facing: tuple[float, float] = (-1.0, 0.0),
    positions: tuple[tuple[float, float], ...] = (),
) -> Scenario:
    return Scenario(
        name="test",
        seed=seed,
        population_seed=seed,
        crowd=CrowdSettings(count=16, start_center=herd_at, start_spacing=2.0, positions=positions),
        world=WorldSettings(corral=CorralSettings(center=corral_at, facing=facing)),
        collie=CollieSettings(start=dog_at),
    )


def penned_after(run: GroupRun, seconds: float = 180.0) -> float:
    """When at least 12 of 16 have been in for 10 s, infinity where that does not happen [s]."""
    for frame in range(round(seconds * FRAME_RATE)):
        run.advance()
        if run.group.referee.totals()["penned_frames"] >= 10 * FRAME_RATE:
            return frame / FRAME_RATE
    return math.inf


@pytest.mark.parametrize("seed", range(1, 11))
def test_the_dog_pens_the_herd(seed: int) -> None:
    run = GroupRun(penning_scenario(seed), robot_seed=seed)
    assert penned_after(run) < 120.0
    run.advance(20 * FRAME_RATE)
    totals = run.group.referee.totals()
    assert totals["inside"] == 16, "all of them, in the end"
    assert totals["collisions"] == 0


@pytest.mark.parametrize(
    ("herd_at", "dog_at"),
    [
        ((20.0, 10.0), (30.0, -14.0)),  # the dog is on the wrong side
        ((7.0, 0.0), (25.0, 2.0)),  # it stands before the mouth, facing in
        ((-25.0, 12.0), (-5.0, -17.0)),
        ((14.0, -12.0), (-10.0, -20.0)),
    ],
)
def test_the_dog_goes_round_to_where_it_must(herd_at: tuple[float, float], dog_at: tuple[float, float]) -> None:
    run = GroupRun(penning_scenario(3, herd_at=herd_at, dog_at=dog_at))
    assert penned_after(run) < 180.0
    assert run.group.referee.totals()["collisions"] == 0


def test_the_dog_brings_a_scattered_herd_together_first() -> None:
    groups = [
        (x + 1.8 * i, y + 1.8 * j) for x, y, n in ((-25.0, 4.0, 3), (18.0, 8.0, 2)) for i in range(n) for j in range(n)
    ]
    places = (*groups, (0.0, -15.0), (2.0, -15.0), (-38.0, 6.0))
    run = GroupRun(penning_scenario(1, positions=places))
    assert penned_after(run) < 180.0


def test_the_corral_may_stand_anywhere() -> None:
    run = GroupRun(penning_scenario(2, herd_at=(-15.0, 0.0), corral_at=(5.0, 21.0), facing=(0.0, -1.0)))
    assert penned_after(run) < 180.0


def test_the_dog_stays_on_the_field_and_keeps_out_of_the_corral() -> None:
    run = GroupRun(penning_scenario(5, herd_at=(20.0, 10.0), dog_at=(30.0, -14.0)))
    collie = run.group.collie
    assert collie is not None
    for _ in range(100 * FRAME_RATE):
        run.advance()
        x, y, _, _ = collie.arrays.user.numpy()[0]
        assert 28.0 - math.hypot(max(abs(x) - 17.0, 0.0), y) > 0.5
        assert max(abs(x - 38.0), abs(y)) > 5.5


def test_without_a_corral_it_drives_to_the_middle_of_the_field() -> None:
    scenario = Scenario(
        name="test",
        crowd=CrowdSettings(count=16, start_center=(-20.0, 5.0), start_spacing=2.0),
        herd=HerdSettings(wander=False),
        collie=CollieSettings(start=(-38.0, 5.0)),
    )
    run = GroupRun(scenario)
    nearest = math.inf
    for _ in range(60 * FRAME_RATE):
        run.advance()
        nearest = min(nearest, float(np.linalg.norm(run.robots.positions.mean(axis=0))))
    assert nearest < 4.0


def test_the_bicycle_rides_the_same_on_every_run() -> None:
    def ride() -> np.ndarray:
        run = GroupRun(penning_scenario(4))
        run.advance(300)
        collie = run.group.collie
        assert collie is not None
        return np.concatenate([wp.array.numpy(collie.arrays.user)[0], run.desired.numpy().ravel()])

    np.testing.assert_array_equal(ride(), ride())
