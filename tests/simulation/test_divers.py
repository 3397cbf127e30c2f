"""Divers: gymnasts at the edge of a platform, and what of it a stage and pictures show."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.agents.gymnasts.standing import site_points
from echelon.errors import InputError
from echelon.export.picture_source import RecordedSource
from echelon.export.stage_source import StageSource
from echelon.export.usd import write_stage
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation, simulate

HEADING = 0.4


def diving(**world: Any) -> Scenario:
    return Scenario.from_dict(
        {
            "name": "divers",
            "seconds": 0.5,
            "crowd": {"character": "gymnast-male", "positions": [[0.02, 0.0]]},
            "world": {"ground": "water", **world},
            "performance": {"maneuver": "stand", "lean": 0.056},
        }
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("dive")
    return simulate(diving(platform={"height": 7.5}), recording=folder / "dive.recording", threads=1)


def test_a_diver_stands_on_the_edge_with_heels_in_the_air() -> None:
    simulation = Simulation(diving(), threads=1)
    body = simulation.character.body
    q = simulation.engine.q[0].astype(float)
    q[:3] += simulation.engine.origins.numpy()[0]
    sites = site_points(body, q)
    assert sites["left_ball_inner"][0] == pytest.approx(0.02, abs=1e-3)
    assert sites["left_heel_inner"][0] < 0.0
    assert sites["left_heel_inner"][2] == pytest.approx(10.0, abs=5e-3)
    # The weight is on the balls of the feet, that is, on the platform.
    assert body.center_of_mass(q)[0] > 0.0
    simulation.close()


def test_a_diver_who_only_stands_does_not_fall_off(recording: Recording) -> None:
    assert recording.summary["falls"] == 0
    height = recording.measures[:, 0, recording.measure_names.index("com_height")]
    assert np.ptp(height[1:]) < 0.05  # nothing is measured before the first tick
    assert recording.link_poses[-1, 0, 0, 2] == pytest.approx(7.5 + 0.98, abs=0.06)


def test_shadows_fall_on_the_platform_or_on_the_water(recording: Recording) -> None:
    platform = RecordedSource(recording).world.platform
    assert platform is not None
    planes = platform.planes(np.array([[0.1, 0.0, 8.5], [-0.1, 0.0, 8.5], [0.1, 0.0, 1.0]]))
    assert planes.tolist() == [[0.0, 0.0, 1.0, 7.5], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]]


def test_a_stage_has_the_platform_and_is_read_back(recording: Recording, tmp_path: Path) -> None:
    source = StageSource(write_stage(recording, tmp_path / "dive.usd", "rig"))
    platform = source.world.platform
    assert platform is not None
    assert (platform.height, platform.edge, platform.heading) == (7.5, (0.0, 0.0), 0.0)
    assert platform.mesh.points[:, 2].max() == pytest.approx(7.5)


def test_a_platform_turns_with_its_heading() -> None:
    world = diving(platform={"heading": HEADING}).world
    assert world.platform is not None
    assert world.platform.heading == HEADING
    simulation = Simulation(
        Scenario.from_dict(
            {
                **diving(platform={"heading": HEADING}).to_dict(),
                "performance": {"maneuver": "stand", "lean": 0.056, "heading": HEADING},
            }
        ),
        threads=1,
    )
    q = simulation.engine.q[0].astype(float)
    q[:3] += simulation.engine.origins.numpy()[0]
    sites = site_points(simulation.character.body, q)
    middle = 0.5 * (sites["left_ball_inner"] + sites["right_ball_inner"])[:2]
    forward = np.array([math.cos(HEADING), math.sin(HEADING)])
    assert (middle - [0.02, 0.0]) @ forward == pytest.approx(0.0, abs=1e-3)
    simulation.close()


def test_a_platform_needs_water_and_water_gymnasts() -> None:
    data = {"name": "x", "crowd": {"character": "gymnast-male", "count": 1}}
    with pytest.raises(InputError, match=r"world\.platform: needs world\.ground = 'water'"):
        Scenario.from_dict({**data, "world": {"ground": "plane", "platform": {}}})
    with pytest.raises(InputError, match=r"world\.ground = 'water': needs crowd\.character"):
        Scenario.from_dict({"name": "x", "world": {"ground": "water"}})
