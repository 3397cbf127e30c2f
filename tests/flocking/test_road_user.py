"""The user on a road: a simple bicycle that cannot reverse, is slow uphill, and keeps to the road."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.scenario.road import ObstacleSettings, PelotonSettings, UserSettings
from tests.flocking.point_cyclists import GRAVITY, PelotonRun, rounded, straight

SETTINGS = PelotonSettings(columns=1)


def test_it_starts_where_it_is_told_and_has_a_pose_from_the_beginning() -> None:
    user = UserSettings(ahead=12.0, keys=((0.0, 8.0, -1.5),))
    run = PelotonRun(SETTINGS, straight(), count=1, user=user)
    (pose,) = run.peloton.actor_poses()
    middle = run.peloton.grid.s[0] + 12.0 + 0.5 * user.wheelbase
    np.testing.assert_allclose(pose, [middle, -1.5, 0.0, 0.0, 0.0, 0.0, 1.0], atol=1e-4)
    assert run.peloton.actors == (("user", "bicycle"),)


@pytest.mark.parametrize("grade", [0.04, 0.08, 0.13])
def test_uphill_it_is_as_slow_as_its_power(grade: float) -> None:
    user = UserSettings(ahead=300.0)
    run = PelotonRun(SETTINGS, straight(2000.0, grade), count=1, user=user)
    run.advance(1500)
    speed = float(run.peloton.riders.speed.numpy()[1])
    pull = user.mass * GRAVITY * (grade + 0.005)
    assert speed * (pull + 0.6 * user.drag_area * speed**2) == pytest.approx(user.power, rel=0.03)
    assert 2.0 < speed < 8.0


def test_its_pose_lies_on_a_hilly_road_leans_into_bends_and_never_goes_back() -> None:
    path = rounded(100.0, 50.0, 20.0, hills=4.0)
    run = PelotonRun(SETTINGS, path, count=1, user=UserSettings(keys=((0.0, 10.0, 1.0),)), laps=3)
    before, leans, bends = -np.inf, [], []
    for _ in range(1500):
        run.advance()
        progress = float(run.peloton.referee.arrays.progress.numpy()[1])
        assert progress > before - 1e-3
        before = progress
        pose = run.peloton.actor_poses()[0]
        s, offset = path.closest(pose[:2])
        assert pose[2] == pytest.approx(float(path.position(s)[2]), abs=0.01)
        assert abs(float(offset)) < 4.0
        x, y, z, w = pose[3:]
        forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
        assert forward[2] == pytest.approx(float(path.tangent(s)[2]), abs=0.03)
        leans.append(np.arcsin(2 * (y * z + x * w)))
        bends.append(float(path.curvature(s)))
    tight = np.abs(bends) > 0.04
    assert np.degrees(np.array(leans)[tight]).mean() < -8.0, "to the left, which is a negative turn about forward"
    assert run.peloton.referee.totals()["off_road"] == 0


def test_it_does_not_cut_corners() -> None:
    """Whoever rides beside has planned for it to keep its line."""
    path = rounded(100.0, 50.0, 20.0)
    run = PelotonRun(SETTINGS, path, count=1, user=UserSettings(keys=((0.0, 9.0, 0.5),)), laps=2)
    run.advance(150)
    astray = []
    for _ in range(1500):
        run.advance()
        riders = run.peloton.riders
        astray.append(float(riders.offset.numpy()[1] - riders.lane.numpy()[1]))
    assert np.abs(astray).max() < 0.15


def test_it_sees_obstacles_and_is_seen() -> None:
    user = UserSettings(ahead=60.0, keys=((0.0, 4.0, 0.0),))
    obstacles = (ObstacleSettings("car", 250.0, 0.0),)
    run = PelotonRun(PelotonSettings(), straight(), user=user, obstacles=obstacles)
    run.advance(2400)
    totals = run.peloton.referee.totals()
    assert (totals["collisions"], totals["struck"]) == (0, 0)
    progress = run.peloton.referee.arrays.progress.numpy()
    assert progress[-1] > 260.0
    assert (progress[:-1] > progress[-1]).all(), "they have overtaken the user"
