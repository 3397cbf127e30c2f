"""A field with a herd on it, a collie, and a corral (`Scene`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp

from echelon.flocking.group import Group
from echelon.recording import EVENT_NAMES, Actor
from echelon.scenario import Scenario
from echelon.simulation.scene import SceneFrames
from echelon.terrain.flat import FlatTerrain
from echelon.terrain.walls import world_dict
from echelon.warp_kernels.character import Character, Population
from echelon.warp_kernels.frame import Engine, Terrain


class Field:
    """The herd's world; see `Scene`.

    Attributes:
        group: What the herd wants.
    """

    measure_names: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario, device: str = "cpu") -> None:
        self.scenario = scenario
        self.terrain: Terrain = FlatTerrain.of(scenario.world, device)
        self.world: Mapping[str, Any] = world_dict(scenario.world)
        self.actors: tuple[Actor, ...] = (Actor("collie", "bicycle"),) if scenario.collie is not None else ()
        self.group = Group(scenario, device=device)
        self._passed: tuple[int, ...] = (0, 0)  # gates and collisions that the referee had counted before
        self._desired: wp.array | None = None
        # On a CPU the referee's counts and the collie's pose are read where they are, without asking Warp each frame.
        collie = self.group.collie
        self._totals_here = self.group.referee.arrays.totals.numpy() if device == "cpu" else None
        self._pose_here = collie.arrays.pose.numpy() if collie is not None and device == "cpu" else None

    def people(self, character: Character) -> tuple[Population, np.ndarray]:
        crowd = self.scenario.crowd
        people = character.population(
            crowd.count, self.scenario.population_seed, crowd.variation, in_phase=crowd.in_phase
        )
        places = self.scenario.start_positions()
        return people, np.column_stack([places, np.zeros(len(places))])

    def step(self, frame: int, engine: Engine) -> None:
        if self._desired is None:
            # The same memory twice: rows of commands for the engine, vectors for the group.
            self._desired = wp.array(
                ptr=engine.command.ptr, dtype=wp.vec2, shape=engine.agent_count, device=engine.command.device
            )
        self.group.step(frame, engine.positions, engine.velocities, self._desired, engine.fallen)

    def keep_actors(self, slot: int, frames: SceneFrames) -> None:
        if self.group.collie is not None:
            pose = self.group.collie.arrays.pose.numpy() if self._pose_here is None else self._pose_here
            frames.actor_poses[slot, 0] = pose[0]

    def keep(self, frame: int, slot: int, frames: SceneFrames) -> None:
        inside, _, gates, collisions = self._referee().tolist()
        frames.in_corral[slot] = inside
        if (gates, collisions) != self._passed:
            for agent in np.flatnonzero(self.group.referee.arrays.gates.numpy()):
                frames.events.append((frame, 0, int(agent), EVENT_NAMES.index("gate")))
            for agent, _ in self.group.referee.collisions():
                frames.events.append((frame, 0, agent, EVENT_NAMES.index("collision")))
            self._passed = (gates, collisions)

    def begin(self) -> None:
        self._passed = tuple(self._referee().tolist()[2:4])

    def _referee(self) -> np.ndarray:
        """What the referee has counted (`echelon.flocking.referee.TOTALS`)."""
        return self.group.referee.arrays.totals.numpy() if self._totals_here is None else self._totals_here

    @property
    def penned(self) -> bool:
        """Whether enough have been in the corral for long enough."""
        corral = self.scenario.world.corral
        if corral is None:
            return False
        return bool(self._referee()[1] >= max(1, round(corral.penned_seconds * self.scenario.frame_rate)))

    @property
    def finished(self) -> bool:
        return self.scenario.until == "penned" and self.penned

    def summary(self, last_frame: int, means: Mapping[str, np.ndarray]) -> dict[str, Any]:
        inside, frames_in = self._referee().tolist()[:2]
        penned = self.penned
        return {
            "in_corral": inside,
            "penned": penned,
            "penned_since": (last_frame - frames_in + 1) / self.scenario.frame_rate if penned else None,
        }

    def state(self) -> dict[str, np.ndarray]:
        return self.group.state()

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        self.group.load_state(state)
