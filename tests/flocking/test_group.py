"""The group layer as a whole: captured launches, resuming to the same bits, its cost."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from echelon.flocking.group import Group
from echelon.scenario import CollieSettings, CorralSettings, CrowdSettings, HerdSettings, Scenario, WorldSettings
from echelon.warp_kernels.replay import GRAPH_LIMIT
from tests.flocking.point_robots import GroupRun

WAYPOINTS = ((5.0, -15.0, 5.0), (12.0, 0.0, 10.0), (20.0, 10.0, -5.0))


def group_scenario(driver: str = "dog", mode: str = "herd", count: int = 16) -> Scenario:
    collies = {
        "dog": CollieSettings(start=(-30.0, 4.0)),
        "waypoints": CollieSettings(driver="waypoints", start=(-30.0, 4.0), waypoints=WAYPOINTS),
        "nobody": None,
    }
    modes = {"herd": HerdSettings(), "random": HerdSettings(mode="random", period=0.5)}
    return Scenario(
        name="test",
        seed=7,
        crowd=CrowdSettings(count=count),
        herd=modes[mode],
        world=WorldSettings(corral=CorralSettings(center=(34.0, 0.0))),
        collie=collies[driver],
    )


@pytest.mark.parametrize(
    ("driver", "mode"), [("dog", "herd"), ("waypoints", "herd"), ("nobody", "herd"), ("nobody", "random")]
)
def test_a_run_resumes_to_the_same_bits(driver: str, mode: str) -> None:
    first = GroupRun(group_scenario(driver, mode))
    first.advance(397)
    state = first.group.state()
    second = GroupRun(group_scenario(driver, mode))
    second.group.load_state(state)
    second.frame, second.robots = first.frame, first.robots
    for frame in range(200):
        np.testing.assert_array_equal(first.want(), second.want(), err_msg=f"frame {frame} after resuming")
        second.robots.advance(second.desired.numpy())
    after = second.group.state()
    for name, array in first.group.state().items():
        np.testing.assert_array_equal(array, after[name], err_msg=name)


def test_a_state_is_a_copy() -> None:
    run = GroupRun(group_scenario())
    run.advance(10)
    state = run.group.state()
    kept = {name: array.copy() for name, array in state.items()}
    run.advance(60)
    for name, array in state.items():
        np.testing.assert_array_equal(array, kept[name], err_msg=name)


def test_captured_launches_do_what_the_launches_do() -> None:
    captured, launched = GroupRun(group_scenario()), GroupRun(group_scenario())
    for frame in range(120):
        desired = captured.want()
        launched.positions.numpy()[:, :2] = captured.robots.positions
        launched.velocities.numpy()[:, :2] = captured.robots.velocities
        group = launched.group
        group.set_frame(frame)
        group.enqueue(launched.positions, launched.velocities, launched.fallen, launched.desired)
        np.testing.assert_array_equal(desired, launched.desired.numpy())
        captured.robots.advance(desired)


def test_arrays_may_change_from_frame_to_frame() -> None:
    run = GroupRun(group_scenario())
    run.want()
    positions, velocities = run.positions.numpy(), run.velocities.numpy()
    expected = run.desired.numpy().copy()
    state = run.group.state()
    for _ in range(2 * GRAPH_LIMIT):
        group = Group(group_scenario(), "cpu")
        places, speeds = (wp.array(values, dtype=wp.vec3, device="cpu") for values in (positions, velocities))
        desired = wp.zeros(16, dtype=wp.vec2, device="cpu")
        group.step(0, places, speeds, desired)
        np.testing.assert_array_equal(desired.numpy(), expected)
    group = run.group
    wanted = []
    for _ in range(2 * GRAPH_LIMIT):
        group.load_state(state)
        places, speeds = (wp.array(values, dtype=wp.vec3, device="cpu") for values in (positions, velocities))
        desired = wp.zeros(16, dtype=wp.vec2, device="cpu")
        group.step(1, places, speeds, desired)
        wanted.append(desired.numpy().copy())
    assert np.abs(wanted[0]).max() > 0.0
    for other in wanted[1:]:
        np.testing.assert_array_equal(other, wanted[0])


def test_the_last_frame_is_looked_at_alone() -> None:
    run = GroupRun(group_scenario())
    run.advance(3)
    before = run.group.state()
    run.positions.numpy()[0] = run.positions.numpy()[1]
    run.group.look(run.frame, run.positions)
    assert run.group.referee.totals()["collisions"] == 1
    after = run.group.state()
    for name in before:
        if not name.startswith("referee"):
            np.testing.assert_array_equal(before[name], after[name], err_msg=name)


def test_one_agent_is_a_herd() -> None:
    run = GroupRun(group_scenario(count=1))
    run.advance(60)
    assert np.isfinite(run.robots.positions).all()


def test_the_seed_of_the_herd_is_the_scenarios() -> None:
    def goal(seed: int) -> list[float]:
        run = GroupRun(replace(group_scenario("nobody"), seed=seed))
        run.want()
        return run.group.herd.arrays.mind.goal.numpy()[0].tolist()

    assert goal(7) == goal(7)
    assert goal(7) != goal(8)


def test_a_frame_of_a_hundred_agents_costs_less_than_they_do() -> None:
    """About 50 microseconds when it was written; thirty times as much would still be real time."""
    run = GroupRun(group_scenario(count=105))
    run.advance(30)
    best = np.inf
    for _ in range(20):
        begin = time.perf_counter()
        for _ in range(10):
            run.group.step(run.frame, run.positions, run.velocities, run.desired, run.fallen)
        best = min(best, (time.perf_counter() - begin) / 10)
    assert best < 1.5e-3, f"{best * 1e6:.0f} microseconds"
