"""A platform carries up to its edge, and nobody beyond it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import load_script
from echelon.agents.gymnasts.standing import site_points
from echelon.benchmarks.thesis.dives import HEIGHT, ON_PLATFORM, divers
from echelon.simulation.ground_below import ground_planes
from echelon.simulation.performance import Performance
from echelon.terrain.platform import DEPTH, PlatformTerrain

UP = (0.0, 0.0, 1.0)


@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, 2.0])
def test_ground_ends_at_the_edge(heading: float) -> None:
    terrain = PlatformTerrain.of(7.5, edge=(3.0, -1.0), heading=heading)
    inward = np.array([math.cos(heading), math.sin(heading), 0.0])
    edge = np.array([3.0, -1.0, 8.0])
    along = np.array([-inward[1], inward[0], 0.0])
    on = np.array([edge + 0.01 * inward, edge + 0.01 * inward + 5.0 * along, edge + 4.0 * inward])
    off = np.array([edge - 0.01 * inward, edge - 0.01 * inward - 5.0 * along, edge - 4.0 * inward])
    np.testing.assert_allclose(ground_planes(terrain, on, "cpu"), np.tile((*UP, 7.5), (3, 1)))
    np.testing.assert_allclose(ground_planes(terrain, off, "cpu"), np.tile((*UP, -DEPTH), (3, 1)))


@pytest.mark.parametrize("sex", ["male", "female"])
def test_divers_stand_with_their_heels_over_the_edge_and_others_fall(sex: str) -> None:
    character = character_named(f"gymnast-{sex}")
    assert isinstance(character, Gymnast)
    dive = load_script("inward-dive-one-and-a-half-pike" if sex == "male" else "inward-dive-two-and-a-half-pike")
    fallen = []
    for people in (divers(character, 8), character.population(8, 0, 0.0, True)):
        balls = site_points(character.body, people.q[0])["left_ball_inner"][0]
        terrain = PlatformTerrain.of(HEIGHT, edge=(balls - ON_PLATFORM, 0.0))
        places = np.tile([0.0, 0.0, HEIGHT], (8, 1))
        # Only the first row, where one stands.
        table = dive.table(character.body)[:1].copy()
        table[:, Gymnast.script.transition_place] = -1.0
        run = Performance(character, [table] * 8, people=people, terrain=terrain, places=places, threads=1)
        run.run(2.5)
        fallen.append(run.now("fallen"))
        run.close()
    assert (fallen[0] == 0.0).all()
    assert (fallen[1] == 1.0).all()
