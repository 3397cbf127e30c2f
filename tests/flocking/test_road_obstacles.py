"""Obstacles on a road: where they are, and which are refused."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.flocking.road_obstacles import obstacle_outline, road_obstacles
from echelon.scenario.road import ObstacleSettings, PelotonSettings
from tests.flocking.point_cyclists import FRAME_RATE, PelotonRun, rounded, straight

SETTINGS = PelotonSettings()


@pytest.mark.parametrize("speed", [2.5, -2.5])
def test_a_jogger_runs_along_the_road_and_looks_where_it_goes(speed: float) -> None:
    path = rounded(60.0, 40.0, 20.0, hills=3.0)
    jogger = ObstacleSettings("jogger", 5.0, 1.5, speed=speed)
    run = PelotonRun(SETTINGS, path, count=1, obstacles=(jogger, ObstacleSettings("car", 60.0, -3.0)))
    assert run.peloton.actors == (("jogger", "jogger"),)
    for frame in range(0, 300, 7):
        run.frame = frame
        run.want()
        (pose,) = run.peloton.actor_poses()
        s = 5.0 + speed * (frame + 1) / FRAME_RATE
        expected = path.position(s)
        np.testing.assert_allclose(pose[:2], expected[:2] + 1.5 * path.left(s), atol=2e-3)
        assert pose[2] == pytest.approx(expected[2], abs=2e-3)
        x, y, z, w = pose[3:]
        forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
        assert forward @ path.tangent(s) * np.sign(speed) > 0.98
        assert 1 - 2 * (x * x + y * y) == pytest.approx(1.0, abs=1e-6), "upright"
    assert run.peloton.obstacles.s.numpy()[1] == pytest.approx(60.0)


def test_before_the_first_frame_everything_is_where_it_starts() -> None:
    run = PelotonRun(SETTINGS, straight(), obstacles=(ObstacleSettings("jogger", 200.0, -2.0, speed=3.0),))
    np.testing.assert_allclose(run.peloton.actor_poses()[0], [200.0, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0], atol=1e-4)


def test_outlines_are_the_boxes() -> None:
    corners = obstacle_outline(ObstacleSettings("car", 100.0, -2.0), straight())
    np.testing.assert_allclose(corners, [[97.8, -2.9], [102.2, -2.9], [102.2, -1.1], [97.8, -1.1]], atol=1e-6)


@pytest.mark.parametrize(
    ("obstacles", "message"),
    [
        ([ObstacleSettings("car", 1600.0)], r"obstacles\[0\]\.distance = 1600: must be at most the length of the road"),
        ([ObstacleSettings("barrier", 100.0, width=7.0)], r"obstacles\[0\]\.offset = 0: leaves a gap of 0\.30 m"),
        (
            [ObstacleSettings("barrier", 100.0, -2.5, width=3.2), ObstacleSettings("barrier", 104.0, 2.0, width=4.2)],
            r"obstacles\[0\]\.offset = -2\.5: leaves a gap of 0\.80 m on a road of 8 m; must leave at least 1\.40 m",
        ),
    ],
)
def test_a_road_that_is_blocked_is_refused(obstacles: list[ObstacleSettings], message: str) -> None:
    with pytest.raises(InputError, match=message):
        road_obstacles(obstacles, SETTINGS, straight(), 4.0, "cpu")


def test_staggered_barriers_are_no_block() -> None:
    far = [ObstacleSettings("barrier", 100.0, -1.5, width=5.0), ObstacleSettings("barrier", 140.0, 1.5, width=5.0)]
    assert road_obstacles(far, SETTINGS, straight(), 4.0, "cpu").start.shape[0] == 2
