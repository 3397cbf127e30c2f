"""Groups on the march: turned aside by what is in the way, kept apart by their laws; without bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.simulation.loop import Simulation
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.frame import ChunkArrays
from tests.flocking.point_robots import GroupRun


def marching(law: str, count: int = 12, **tables: dict) -> GroupRun:
    """A group of point robots, told to go along x at 1 m/s."""
    herd = {"mode": "march", "law": law, "desired_velocity": [1.0, 0.0], "wall_distance": 0.8, "sight": 12.0}
    data = {
        "name": "march",
        "crowd": {"count": count, "start_spacing": 2.0, **tables.get("crowd", {})},
        "herd": herd | tables.get("herd", {}),
        "world": {"ground": "plane", **tables.get("world", {})},
    }
    return GroupRun(Scenario.from_dict(data))


@pytest.mark.parametrize("law", ["brogan-hodgins", "approach", "foresight", "alone"])
def test_one_alone_goes_as_it_is_told_and_turns_when_told(law: str) -> None:
    run = marching(law, 1, herd={"turns": [[2.0, 0.0, 1.0]]})
    run.advance(45)
    assert run.want()[0] == pytest.approx([1.0, 0.0], abs=0.12)
    run.advance(120)
    assert run.want()[0] == pytest.approx([0.0, 1.0], abs=0.12)


@pytest.mark.parametrize("law", ["brogan-hodgins", "approach", "foresight"])
def test_two_who_stand_too_near_part_and_two_too_far_come_together(law: str) -> None:
    for start, way in ((1.2, 1.0), (5.0, -1.0)):
        run = marching(law, 2, crowd={"positions": [[0.0, 0.0], [0.0, start]]}, herd={"spacing": 2.5})
        run.advance(90)
        gap = np.linalg.norm(run.robots.positions[1] - run.robots.positions[0])
        assert (gap - start) * way > 0.3


def test_the_way_leads_round_a_column_on_the_nearer_side() -> None:
    for side in (0.3, -0.3):
        run = marching("alone", 1, crowd={"positions": [[0.0, side]]}, world={"columns": [[8.0, 0.0, 0.5]]})
        wanted = run.want()[0].copy()
        assert np.sign(wanted[1]) == np.sign(side)
        assert np.linalg.norm(wanted) == pytest.approx(1.0, abs=1e-5)
        run.advance(400)
        assert run.robots.positions[0, 0] > 10.0


def test_the_way_leads_through_the_gap() -> None:
    gap = {"center": [10.0, 0.0], "opening": 4.0, "width": 60.0}
    run = marching("alone", 1, crowd={"positions": [[0.0, 7.0]]}, world={"gap": gap})
    assert run.want()[0, 1] < -0.3
    run.advance(600)
    assert run.robots.positions[0, 0] > 12.0


def test_what_is_out_of_sight_changes_nothing() -> None:
    world = {"columns": [[30.0, 0.0, 0.5]]}
    assert marching("alone", 1, world=world).want()[0] == pytest.approx([1.0, 0.0], abs=1e-6)


def test_the_fallen_want_nothing_and_are_passed() -> None:
    run = marching("approach", 2, crowd={"positions": [[0.0, 0.0], [4.0, 0.05]]})
    run.fallen.numpy()[1] = 1
    assert run.want()[1] == pytest.approx([0.0, 0.0])
    nearest = 9.0
    for _ in range(20):
        run.advance(20)
        run.robots.velocities[1] = 0.0
        run.robots.positions[1] = (4.0, 0.05)
        nearest = min(nearest, float(np.linalg.norm(run.robots.positions[0] - run.robots.positions[1])))
    assert nearest > 0.7


@pytest.mark.parametrize("law", ["brogan-hodgins", "approach", "foresight"])
def test_the_same_group_wants_the_same_again(law: str) -> None:
    first, again = (marching(law, 30, world={"columns": [[10.0, 1.0, 0.5]]}) for _ in range(2))
    first.advance(60)
    again.advance(60)
    assert np.array_equal(first.want(), again.want())


def test_turns_must_come_one_after_the_other() -> None:
    with pytest.raises(InputError, match=r"herd\.turns\[1\] = .*must be later than 5 s"):
        marching("approach", 2, herd={"turns": [[5.0, 0.0, 1.0], [4.0, 1.0, 0.0]]})


@pytest.mark.parametrize("name", ["gap", "columns"])
def test_threads_change_no_bit(name: str) -> None:
    hashes = set()
    for threads in (1, 2):
        scenario = replace(Scenario.load(name), seconds=0.5)
        simulation = Simulation(scenario, threads=threads)
        engine = simulation.engine
        engine.bind(ChunkArrays.allocate(1, engine.agent_count, simulation.character, engine.device))
        seen = SceneFrames.allocate(1, simulation.scene, engine.agent_count)
        for _ in range(scenario.step_count + 1):
            simulation.advance(0, seen)
        hashes.add(simulation.state_hash())
        simulation.close()
    assert len(hashes) == 1
