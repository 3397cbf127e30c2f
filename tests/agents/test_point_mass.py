"""The point mass: it takes up any velocity, as far as its acceleration allows, stays level, and stops at walls."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.point_mass import ACCELERATION_LIMIT, RADIUS
from echelon.scenario import Scenario
from echelon.simulation.loop import Simulation
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.frame import ChunkArrays


def slide(seconds: float, **tables: dict) -> tuple[np.ndarray, np.ndarray]:
    """Places and velocities of pucks in each frame, shape [frames, pucks, 3] each."""
    data = {
        "name": "pucks",
        "seconds": seconds,
        "crowd": {"character": "point-mass", "count": 2, "variation": 0.0, **tables.get("crowd", {})},
        "herd": {"mode": "constant", "desired_velocity": [1.5, 0.0], **tables.get("herd", {})},
        "world": {"ground": "plane", **tables.get("world", {})},
    }
    scenario = Scenario.from_dict(data)
    simulation = Simulation(scenario, threads=1)
    engine = simulation.engine
    engine.bind(ChunkArrays.allocate(1, engine.agent_count, simulation.character, engine.device))
    seen = SceneFrames.allocate(1, simulation.scene, engine.agent_count)
    places, velocities = [], []
    for _ in range(scenario.step_count + 1):
        simulation.advance(0, seen)
        places.append(engine.positions.numpy().copy())
        velocities.append(engine.velocities.numpy().copy())
    simulation.close()
    return np.array(places), np.array(velocities)


def test_it_accelerates_as_far_as_it_may_and_arrives_at_the_velocity() -> None:
    places, velocities = slide(3.0)
    assert velocities[-1, :, 0] == pytest.approx([1.5, 1.5], abs=0.01)
    gained = np.diff(velocities[:, 0, 0]) * 30.0
    assert gained.max() == pytest.approx(ACCELERATION_LIMIT, rel=0.02)
    assert np.abs(np.diff(places[:, :, 2], axis=0)).max() < 1e-4, "it stays on the ground, neither sinks nor hops"


def test_it_starts_at_the_velocity_it_is_given() -> None:
    _, velocities = slide(0.5, crowd={"start_velocity": [1.5, 0.0]})
    assert velocities[..., 0] == pytest.approx(np.full(velocities.shape[:2], 1.5), abs=0.01)


def test_it_stops_at_a_wall_and_at_a_column() -> None:
    wall = {"walls": [{"points": [[3.0, -9.0], [3.0, 2.0]]}], "columns": [[4.0, 4.0, 0.5]]}
    places, _ = slide(6.0, crowd={"positions": [[0.0, 0.0], [0.0, 4.0]]}, world=wall, herd={"wall_gain": 0.0})
    assert places[-1, 0, 0] == pytest.approx(3.0 - RADIUS, abs=0.06)
    assert places[:, 1, 0].max() < 3.5 - RADIUS + 0.06
