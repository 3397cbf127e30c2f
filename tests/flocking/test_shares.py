"""The group layer in parts, as ranks have it, and in slices, as threads do: the same wants, whoever works them out."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from echelon.scenario import (
    CollieSettings,
    CorralSettings,
    CrowdSettings,
    HerdSettings,
    Scenario,
    WorldSettings,
)
from echelon.scenario.road import ObstacleSettings, PelotonSettings, TacticsSettings, UserSettings
from echelon.terrain.spline import Centreline
from echelon.warp_kernels.replay import Share, Team
from tests.flocking.point_cyclists import PelotonRun
from tests.flocking.point_robots import GroupRun

HERDS = {
    "herd": HerdSettings(),
    "random": HerdSettings(mode="random", period=0.5),
    "constant": HerdSettings(mode="constant", desired_velocity=(1.0, 0.5)),
    "march": HerdSettings(mode="march"),
}


def shared(count: int, beyond: int, parts: int, threads: int) -> list[Share]:
    bounds = [count * i // parts for i in range(parts + 1)]
    return [Share(count, a, b - a, Team(threads), beyond) for a, b in itertools.pairwise(bounds)]


@pytest.mark.parametrize(("parts", "threads"), [(1, 3), (3, 1), (2, 2)])
@pytest.mark.parametrize("mode", HERDS)
def test_a_herd_in_parts_wants_what_it_wants_as_a_whole(mode: str, parts: int, threads: int) -> None:
    count = 600  # several blocks, of which parts begin anywhere
    scenario = Scenario(
        name="test",
        crowd=CrowdSettings(count=count, start_spacing=0.9, start_jitter=0.05),
        herd=HERDS[mode],
        world=WorldSettings(corral=CorralSettings(center=(34.0, 0.0))),
        collie=CollieSettings(start=(-20.0, 4.0)),
    )
    whole, runs = GroupRun(scenario), [GroupRun(scenario) for _ in range(parts)]
    shares = shared(count, 0, parts, threads)
    for run, share in zip(runs, shares, strict=True):
        run.group.share = share
    collisions = 0
    for _ in range(30):
        expected = whole.want().copy()
        collisions += len(whole.group.referee.collisions())
        found = np.zeros_like(expected)
        for run, share in zip(runs, shares, strict=True):
            run.robots = whole.robots
            own = slice(share.first, share.first + share.count)
            found[own] = run.want()[own]
        np.testing.assert_array_equal(found, expected)
        for run in runs:  # what ranks tell each other
            run.group.herd.arrays.intended.numpy()[:] = whole.group.herd.arrays.intended.numpy()
            for name in ("centroid", "goal", "fleeing"):
                mine, theirs = (getattr(r.group.herd.arrays.mind, name).numpy() for r in (run, whole))
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
            assert run.group.collie is not None
            assert whole.group.collie is not None
            np.testing.assert_array_equal(run.group.collie.arrays.pose.numpy(), whole.group.collie.arrays.pose.numpy())
        whole.robots.advance(expected)
    expected_totals = whole.group.referee.totals()
    totals = [run.group.referee.totals() for run in runs]
    for name in ("inside", "penned_frames", "gates"):
        assert {found[name] for found in totals} == {expected_totals[name]}
    assert sum(found["collisions"] for found in totals) == expected_totals["collisions"] == collisions
    assert collisions > 0, "it would be no test of counting them"
    for share in shares:
        share.team.close()


@pytest.mark.parametrize(("parts", "threads"), [(1, 3), (3, 1), (2, 2)])
def test_a_peloton_in_parts_rides_as_it_does_as_a_whole(parts: int, threads: int) -> None:
    s = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    points = np.column_stack([120.0 * np.cos(s), 80.0 * np.sin(s), np.zeros(60)])
    count = 40
    shares = shared(count, 1, parts, threads)

    def ride() -> PelotonRun:
        settings = PelotonSettings(drafting=True, tactics=TacticsSettings())
        obstacles = (ObstacleSettings("jogger", 120.0, 1.0, speed=2.0),)
        road = Centreline(points, closed=True)
        return PelotonRun(settings, road, count=count, obstacles=obstacles, user=UserSettings())

    whole, runs = ride(), [ride() for _ in range(parts)]
    for run, share in zip(runs, shares, strict=True):
        run.peloton.share = share
    for _ in range(60):
        expected = whole.want().copy()
        for run, share in zip(runs, shares, strict=True):
            run.cyclists = whole.cyclists
            own = slice(share.first, share.first + share.count)
            np.testing.assert_array_equal(run.want()[own], expected[own])
            np.testing.assert_array_equal(run.peloton.actor_poses(), whole.peloton.actor_poses())
        for run in runs:
            for name in ("lane", "target", "command_speed"):
                mine, theirs = (getattr(r.peloton.riders, name).numpy() for r in (run, whole))
                np.testing.assert_array_equal(mine[count:], theirs[count:], err_msg=name)
                mine[:] = theirs
            np.testing.assert_array_equal(
                run.peloton.referee.arrays.finish_frame.numpy(), whole.peloton.referee.arrays.finish_frame.numpy()
            )
        whole.cyclists.advance(expected, np.zeros(count))
    for name, array in whole.peloton.referee.state().items():
        for run, share in zip(runs, shares, strict=True):
            rows: Any = slice(share.first, share.first + share.count) if len(array) > 1 else slice(None)
            np.testing.assert_array_equal(
                run.peloton.referee.state()[name].numpy()[rows], array.numpy()[rows], err_msg=name
            )
    for share in shares:
        share.team.close()
