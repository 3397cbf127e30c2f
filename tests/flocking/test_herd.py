"""The herd on point robots: it settles in a circle, wanders, flees, and runs into nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import warp as wp
from scipy.spatial import KDTree

from echelon.flocking.herd import Herd
from echelon.scenario import CollieSettings, CorralSettings, CrowdSettings, HerdSettings, Scenario, WorldSettings
from echelon.terrain.walls import infield_walls, segments
from tests.flocking.point_robots import GroupRun

BODY = 0.35  # [m], radius


def herd_scenario(
    count: int = 16,
    seed: int = 1,
    herd: HerdSettings | None = None,
    world: WorldSettings | None = None,
    crowd: CrowdSettings | None = None,
    collie: CollieSettings | None = None,
) -> Scenario:
    return Scenario(
        name="test",
        seed=seed,
        population_seed=seed,
        crowd=crowd or CrowdSettings(count=count),
        herd=herd or HerdSettings(),
        world=world or WorldSettings(),
        collie=collie,
    )


def nearest_distances(positions: np.ndarray) -> np.ndarray:
    return KDTree(positions).query(positions, k=2)[0][:, 1]


def elongation(positions: np.ndarray) -> float:
    low, high = np.linalg.eigvalsh(np.cov(positions.T))
    return math.sqrt(high / low)


@pytest.mark.parametrize("count", [16, 105])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_undisturbed_they_settle_in_a_circle_of_even_density(count: int, seed: int) -> None:
    run = GroupRun(herd_scenario(count, seed, HerdSettings(wander=False)), robot_seed=seed)
    nearest = math.inf
    for _ in range(60):
        run.advance(30)
        nearest = min(nearest, nearest_distances(run.robots.positions).min())
    distances = nearest_distances(run.robots.positions)
    assert elongation(run.robots.positions) <= 1.35
    assert distances.std() / distances.mean() <= 0.15
    assert nearest > 2.0 * BODY + 0.3
    assert run.group.referee.totals()["collisions"] == 0
    assert np.linalg.norm(run.robots.velocities, axis=1).mean() < 2.0 * 0.15, "it has come to rest"


def test_they_keep_apart_and_together() -> None:
    """Two alone come to stand `spacing` apart, from nearer and from farther."""
    for start in (1.0, 6.0):
        crowd = CrowdSettings(count=2, positions=((0.0, 0.0), (start, 0.0)))
        run = GroupRun(herd_scenario(2, crowd=crowd, herd=HerdSettings(wander=False)))
        run.advance(900)
        places = []
        for _ in range(300):
            run.advance()
            places.append(np.linalg.norm(run.robots.positions[1] - run.robots.positions[0]))
        assert np.mean(places) == pytest.approx(2.5, abs=0.15)


def test_the_herd_wanders_from_goal_to_goal_within_the_fence() -> None:
    run = GroupRun(herd_scenario(world=WorldSettings(corral=CorralSettings(center=(38.0, 0.0)))))
    world = run.group.herd.rules
    goals: list[tuple[float, float]] = []
    for _ in range(150):
        run.advance(30)
        goal = tuple(run.group.herd.arrays.mind.goal.numpy()[0].tolist())
        if not goals or goals[-1] != goal:
            goals.append(goal)
        assert run.group.herd.arrays.mind.fleeing.numpy()[0] == 0
    assert len(goals) >= 4
    assert len(set(goals)) == len(goals)
    straight = world.goal_half_length - world.goal_radius
    for x, y in goals:
        assert math.hypot(max(abs(x) - straight, 0.0), y) <= world.goal_radius
        assert max(abs(x - 38.0), abs(y)) > 5.0, "no goal lies in the corral"
    speeds = np.linalg.norm(run.robots.velocities, axis=1)
    assert speeds.max() < 1.6, "half of max_speed, the velocity error aside"
    assert run.group.referee.totals()["collisions"] == 0
    assert run.group.referee.totals()["gates"] == 0


def test_the_seed_decides_on_the_goals() -> None:
    def first_goal(seed: int) -> list[float]:
        run = GroupRun(herd_scenario(seed=seed))
        run.want()
        return run.group.herd.arrays.mind.goal.numpy()[0].tolist()

    assert first_goal(1) == first_goal(1)
    assert first_goal(1) != first_goal(2)


# ---- fleeing ---------------------------------------------------------------------------------------------------------
def desired_beside_collie(distance: float) -> tuple[np.ndarray, np.ndarray, bool]:
    """Positions, desired velocities and whether they flee, from a collie that stands in -x of the centroid."""
    crowd = CrowdSettings(count=16, start_spacing=1.6, start_jitter=0.0)
    calm = HerdSettings(wander=False)
    centroid = herd_scenario(crowd=crowd).start_positions().mean(axis=0)
    stand = (float(centroid[0]) - distance, float(centroid[1]))
    collie = CollieSettings(driver="waypoints", start=stand, waypoints=((0.0, *stand),))
    run = GroupRun(herd_scenario(crowd=crowd, herd=calm, collie=collie))
    for _ in range(30):  # nobody moves, but everybody learns what the others are about to do
        run.want()
    desired = run.desired.numpy().copy()
    return run.robots.positions, desired, bool(run.group.herd.arrays.mind.fleeing.numpy()[0])


def test_they_flee_when_the_collie_is_near_the_centroid() -> None:
    _, _, calm = desired_beside_collie(15.1)
    _, desired, scared = desired_beside_collie(14.9)
    assert (calm, scared) == (False, True)
    assert desired[:, 0].mean() > 0.1


def test_the_nearer_the_collie_the_faster_they_flee() -> None:
    speeds = [desired_beside_collie(distance)[1][:, 0].mean() for distance in (14.0, 13.0, 12.0)]
    assert speeds[0] + 0.1 < speeds[1] < speeds[2] - 0.1
    positions, desired, _ = desired_beside_collie(14.0)
    _, undisturbed, _ = desired_beside_collie(16.0)
    slope = np.polyfit(positions[:, 0], desired[:, 0] - undisturbed[:, 0], 1)[0]
    assert slope < -0.04, "those who are nearer to it flee faster"


def test_the_whole_herd_takes_flight_within_seconds() -> None:
    stand = (-40.0, 0.0)
    collie = CollieSettings(driver="waypoints", start=stand, waypoints=((0.0, *stand),))
    run = GroupRun(herd_scenario(herd=HerdSettings(wander=False), collie=collie))
    run.advance(600)
    near = run.robots.positions.mean(axis=0) - (9.0, 0.0)
    assert run.group.collie is not None
    arrays = run.group.collie.arrays
    arrays.bicycle.place.assign(near[None].astype(np.float32))
    arrays.user.assign(np.array([[*near, 0.0, 0.0]], dtype=np.float32))
    run.advance(45)
    assert run.robots.velocities[:, 0].mean() > 1.0
    assert run.robots.velocities[:, 0].min() > 0.5


def test_flight_is_along_the_ray_from_the_collie_to_the_centroid() -> None:
    _, desired, _ = desired_beside_collie(12.0)
    mean = desired.mean(axis=0)
    assert abs(mean[1]) < 0.05 * mean[0]


# ---- limits ----------------------------------------------------------------------------------------------------------
def test_no_one_is_asked_for_more_than_a_hop_can_give() -> None:
    collie = CollieSettings(start=(-30.0, 3.0), max_speed=12.0, start_speed=12.0, max_acceleration=10.0)
    run = GroupRun(herd_scenario(collie=collie))
    for _ in range(600):
        desired = run.want()
        assert np.linalg.norm(desired - run.robots.velocities, axis=1).max() <= 1.0 + 1e-5
        assert np.linalg.norm(desired, axis=1).max() <= 2.0 + 1e-5
        run.robots.advance(desired)
    assert run.robots.largest_change > 0.5, "the test has scared them"


def test_no_one_is_driven_into_a_fence() -> None:
    """A rider chases the herd to the end of the field and keeps it there."""
    waypoints = ((0.0, 18.0, 1.0), (15.0, 29.0, 1.0))
    collie = CollieSettings(driver="waypoints", start=(18.0, 1.0), waypoints=waypoints)
    crowd = CrowdSettings(count=16, start_center=(33.0, 0.0), start_spacing=1.8)
    run = GroupRun(herd_scenario(crowd=crowd, collie=collie))
    walls = segments(infield_walls(WorldSettings()))
    samples = (walls[:, :2] + np.linspace(0, 1, 200)[:, None, None] * (walls[:, 2:] - walls[:, :2])).reshape(-1, 2)
    fence = KDTree(samples)
    nearest = math.inf
    for _ in range(1200):
        run.advance()
        nearest = min(nearest, float(fence.query(run.robots.positions)[0].min()))
    assert 0.5 < nearest < 3.0, "they were at the fence, and kept off it"
    assert run.group.referee.totals()["collisions"] == 0


# ---- who does not take part ------------------------------------------------------------------------------------------
def test_the_fallen_are_left_behind_and_kept_clear_of() -> None:
    run = GroupRun(herd_scenario(herd=HerdSettings(wander=False)))
    run.fallen.numpy()[3] = 1
    desired = run.want()
    assert desired[3].tolist() == [0.0, 0.0]
    others = np.delete(run.robots.positions, 3, axis=0)
    np.testing.assert_allclose(run.group.herd.arrays.mind.centroid.numpy()[0], others.mean(axis=0), atol=1e-5)
    assert run.group.herd.arrays.mind.member_count.numpy()[0] == 15
    run.advance(600)
    assert run.group.referee.totals()["collisions"] == 0


def test_one_whose_state_is_lost_changes_nothing_for_the_others() -> None:
    whole = CrowdSettings(count=16, start_spacing=2.0)
    calm = HerdSettings(wander=False)  # where they wander depends on how many they are
    places = herd_scenario(crowd=whole).start_positions()
    run = GroupRun(herd_scenario(crowd=whole, herd=calm))
    run.robots.positions[5] = math.nan
    run.robots.velocities[5] = math.nan
    with_lost = run.want().copy()
    without = np.delete(places, 5, axis=0)
    crowd = CrowdSettings(count=15, positions=tuple((float(x), float(y)) for x, y in without))
    alone = GroupRun(herd_scenario(crowd=crowd, herd=calm)).want()
    np.testing.assert_array_equal(np.delete(with_lost, 5, axis=0), alone)
    assert with_lost[5].tolist() == [0.0, 0.0]


# ---- other modes -----------------------------------------------------------------------------------------------------
def test_mode_constant_asks_everybody_for_the_same() -> None:
    run = GroupRun(herd_scenario(herd=HerdSettings(mode="constant", desired_velocity=(1.25, -0.5))))
    np.testing.assert_array_equal(run.want(), np.tile([1.25, -0.5], (16, 1)))


def test_mode_random_changes_each_ones_velocity_at_times() -> None:
    settings = HerdSettings(mode="random", change=1.0, period=2.0, max_speed=2.0)
    run = GroupRun(herd_scenario(105, herd=settings, world=WorldSettings(ground="plane")))
    wanted = np.array([run.want().copy() for _ in range(30 * 20)])
    steps = np.linalg.norm(np.diff(wanted, axis=0), axis=2)
    changing = np.flatnonzero(steps.max(axis=1) > 0.0) + 1
    np.testing.assert_array_equal(changing, np.arange(60, 600, 60))
    assert steps.max() <= 1.0 + 1e-5
    assert np.linalg.norm(wanted, axis=2).max() <= 2.0 + 1e-5
    sizes = steps[changing - 1].ravel()
    assert np.quantile(sizes, 0.5) == pytest.approx(math.sqrt(0.5), abs=0.1), "even over a disc"
    first = wanted[0]
    assert len(np.unique(first, axis=0)) == 105, "each one has its own"


def test_random_changes_do_not_depend_on_how_many_there_are() -> None:
    settings = HerdSettings(mode="random")
    few = GroupRun(herd_scenario(3, herd=settings)).want()
    many = GroupRun(herd_scenario(40, herd=settings)).want()
    np.testing.assert_array_equal(few, many[:3])


# ---- blocks ----------------------------------------------------------------------------------------------------------
def test_sums_over_many_blocks_are_right() -> None:
    count = 1000
    settings = HerdSettings(wander=False)
    world = WorldSettings(ground="plane")
    herd = Herd(settings, world, count, frame_rate=30, seed=1, device="cpu")
    places = np.random.default_rng(8).uniform(-60.0, 60.0, (count, 3)).astype(np.float32)
    frame = wp.zeros(1, dtype=wp.int32, device="cpu")
    nobody = wp.zeros(count, dtype=wp.int32, device="cpu")
    still = wp.zeros(count, dtype=wp.vec3, device="cpu")
    desired = wp.zeros(count, dtype=wp.vec2, device="cpu")
    herd.enqueue(frame, wp.array(places, dtype=wp.vec3, device="cpu"), still, nobody, desired)
    centroid = places[:, :2].mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(herd.arrays.mind.centroid.numpy()[0], centroid, atol=1e-4)
    farthest = herd.arrays.farthest.numpy()
    away = np.linalg.norm(places[:, :2] - centroid, axis=1)
    assert farthest[:, 2].max() == pytest.approx(away.max(), abs=1e-4)
    np.testing.assert_array_equal(farthest[farthest[:, 2].argmax(), :2], places[away.argmax(), :2])
