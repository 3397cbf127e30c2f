"""A field with a herd on it, a collie, and a corral (`Scene`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from echelon.agents.riders.cyclist import Cyclist
from echelon.flocking.group import Group
from echelon.flocking.herd import Herd
from echelon.flocking.person import CONTROLS
from echelon.flocking.referee import Referee
from echelon.recording import EVENT_NAMES, Actor
from echelon.scenario import CrowdSettings, Scenario
from echelon.simulation.scene import SceneFrames
from echelon.terrain.flat import FlatTerrain
from echelon.terrain.walls import world_dict
from echelon.warp_kernels.character import Character, Population
from echelon.warp_kernels.frame import Engine, Terrain
from echelon.warp_kernels.replay import Share

AIM_DISTANCE = 8.0
"""How far ahead riders on a field steer for a point in the direction that they want [m]."""


class Field:
    """The herd's world; see `Scene`.

    Attributes:
        group: What the herd wants.
    """

    measure_names: tuple[str, ...] = ()
    beyond = 0
    by_agent = frozenset(
        [*(f"herd.{name}" for name in Herd.by_agent), *(f"referee.{name}" for name in Referee.by_agent)]
    )

    def __init__(self, scenario: Scenario, device: str = "cpu") -> None:
        self.scenario = scenario
        self.terrain: Terrain = FlatTerrain.of(scenario.world, device)
        self.world: Mapping[str, Any] = world_dict(scenario.world)
        self.actors: tuple[Actor, ...] = (Actor("collie", "bicycle"),) if scenario.collie is not None else ()
        ridden = scenario.collie is not None and scenario.collie.driver == "person"
        self.control_names: tuple[str, ...] = CONTROLS if ridden else ()
        self.group = Group(scenario, device=device)
        self._passed: tuple[int, ...] = (0, 0)  # gates and collisions that the referee had counted before
        self._desired: wp.array | None = None
        # On a CPU the referee's counts and the collie's pose are read where they are, without asking Warp each frame.
        collie = self.group.collie
        self._totals_here = self.group.referee.arrays.totals.numpy() if device == "cpu" else None
        self._pose_here = collie.arrays.pose.numpy() if collie is not None and device == "cpu" else None

    def divide(self, share: Share) -> None:
        self.group.share = share

    def load(self) -> None:
        self.group.load()

    def people(self, character: Character) -> tuple[Population, np.ndarray]:
        crowd = self.scenario.crowd
        people = started(character, crowd, self.scenario.population_seed)
        places = self.scenario.start_positions()
        return people, np.column_stack([places, np.zeros(len(places))])

    def prepare(self, engines: Sequence[Engine]) -> None:
        """Everything that they go by comes frame by frame."""

    def public(self) -> dict[str, wp.array]:
        return {"intended": self.group.herd.arrays.intended}

    def step(self, frame: int, engine: Engine, between: Callable[[], None] | None = None) -> None:
        if self._desired is None:
            self._desired = _first_commands(engine)
        self.group.step(frame, engine.positions, engine.velocities, self._desired, engine.fallen, between)

    def ride(self, controls: np.ndarray) -> None:
        assert self.group.collie is not None
        self.group.collie.arrays.controls.assign(controls)

    def tallies(self) -> dict[str, wp.array]:
        return {}

    def keep_actors(self, slot: int, frames: SceneFrames) -> None:
        if self.group.collie is not None:
            pose = self.group.collie.arrays.pose.numpy() if self._pose_here is None else self._pose_here
            frames.actor_poses[slot, 0] = pose[0]

    def keep(self, frame: int, slot: int, frames: SceneFrames) -> None:
        inside, _, gates, collisions = self._referee().tolist()
        frames.in_corral[slot] = inside
        if (gates, collisions) != self._passed:
            for agent in np.flatnonzero(self.group.referee.arrays.gates.numpy()).tolist():
                if self.group.share.owns(agent):
                    frames.events.append((frame, 0, agent, EVENT_NAMES.index("gate")))
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


def started(character: Character, crowd: CrowdSettings, seed: int) -> Population:
    """A crowd as it sets off, at the velocity that its settings say.

    Args:
        character: Who.
        crowd: How many, how different, how fast and whither.
        seed: Of what differs.
    """
    x, y = crowd.start_velocity
    if isinstance(character, Cyclist):
        return character.population(
            crowd.count, seed, crowd.variation, crowd.in_phase, heading=math.atan2(y, x), speed=math.hypot(x, y)
        )
    people = character.population(crowd.count, seed, crowd.variation, crowd.in_phase)
    if (x, y) == (0.0, 0.0):
        return people
    people.u[:, 0] += x
    people.u[:, 1] += y
    # What a controller already wants is what it has; a hopper would brake in its first stance otherwise.
    held = {name: np.full(crowd.count, value) for name, value in (("wanted_x", x), ("wanted_y", y))}
    return replace(people, memory={**people.memory, **{k: v for k, v in held.items() if k in character.memory}})


def _first_commands(engine: Engine) -> wp.array[wp.vec2]:
    """The same memory twice: rows of commands for the engine; of each the first two, a vector, for the group.

    Riders also have a distance at which they steer for a point; all take the same.
    """
    names = engine.character.commands
    if "look_ahead" in names:
        engine.set_command("look_ahead", np.full(engine.agent_count, AIM_DISTANCE))
    rows = engine.command
    stride = 4 * rows.shape[1]  # [bytes]
    return wp.array(ptr=rows.ptr, dtype=wp.vec2, shape=rows.shape[0], strides=(stride,), device=rows.device)
