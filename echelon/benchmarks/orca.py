"""A kinematic planner that drives our characters: ORCA, by the package `pyrvo` (bindings of the RVO2 library).

Optimal reciprocal collision avoidance (van den Berg et al. 2011) takes everybody for a disc that has any velocity it
wants at once, and gives each the velocity nearest to the preferred one that keeps clear of all others for some
seconds, if all do as they are told. Here it is told in every frame where our characters really are and how they really
move, and its velocities are what they are asked for; its preferred velocities are the group's, turned aside for what is
in the way as for our own laws. What goes wrong then is what dynamics cost a kinematic planner.
"""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.terrain.walls import COLUMN_SIDES, column_segments, infield_walls, segments
from echelon.warp_kernels.frame import Engine

PACKAGE = "pyrvo"
NEIGHBOURS = 10
HORIZON = 3.0  # for which velocities keep clear of others [s]
WALL_HORIZON = 2.0  # and of walls [s]


def orca_version() -> str:
    """Version of the package, empty where it is not installed."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return ""


class OrcaPlanner:
    """Says the velocities of a crowd on a field, instead of its herd, whose law "alone" says the preferred ones."""

    def __init__(self, scenario: Scenario) -> None:
        """Tell the planner who and what there is.

        Raises:
            InputError: The package is not installed.
        """
        if not orca_version():
            raise InputError(f"law 'orca': needs the package {PACKAGE}; pip install echelon[bench]")
        herd, world = scenario.herd, scenario.world
        rvo: Any = importlib.import_module(PACKAGE)
        self._planner = rvo.RVOSimulator(
            1.0 / scenario.frame_rate,
            herd.visibility,
            NEIGHBOURS,
            HORIZON,
            WALL_HORIZON,
            herd.radius + 0.5 * herd.clearance,
            herd.max_speed,
        )
        for place in scenario.start_positions().tolist():
            self._planner.add_agent(tuple(place))
        for x0, y0, x1, y1 in segments(infield_walls(world)).tolist():
            self._planner.add_obstacle([(x0, y0), (x1, y1)])
        for corners in column_segments(world).reshape(-1, COLUMN_SIDES, 4):
            self._planner.add_obstacle([tuple(corner) for corner in corners[:, :2].tolist()])
        self._planner.process_obstacles()

    def plan(self, engine: Engine) -> None:
        """Replace the velocities that everybody wants for the next frame."""
        planner, wanted = self._planner, engine.command.numpy()
        places, velocities = engine.positions.numpy()[:, :2], engine.velocities.numpy()[:, :2]
        here = zip(places.tolist(), velocities.tolist(), wanted[:, :2].tolist(), strict=True)
        for agent, (place, velocity, wish) in enumerate(here):
            planner.set_agent_position(agent, tuple(place))
            planner.set_agent_velocity(agent, tuple(velocity))
            planner.set_agent_pref_velocity(agent, tuple(wish))
        planner.do_step()
        wanted[:, :2] = [planner.get_agent_velocity(agent).to_tuple() for agent in range(len(places))]
        engine.command.assign(wanted)
