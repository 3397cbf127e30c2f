"""A road with riders on it, a user among them, and what stands in their way (`Scene`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import warp as wp

from echelon.agents.riders.cyclist import Cyclist
from echelon.flocking.peloton import Peloton
from echelon.flocking.person import CONTROLS
from echelon.flocking.road_obstacles import obstacle_outline
from echelon.flocking.road_riders import UNFINISHED
from echelon.recording import EVENT_NAMES, Actor
from echelon.scenario import Scenario
from echelon.simulation.scene import SceneFrames
from echelon.terrain.course import Course
from echelon.terrain.road import RoadTerrain
from echelon.warp_kernels.character import Character, Population
from echelon.warp_kernels.frame import Engine, Terrain
from echelon.warp_kernels.replay import Share

MEANS = ("power", "cadence", "shelter")
"""Measures whose mean over the run a rider's summary tells."""


_OF_USER = ".user"  # ends the names of the user's rows of what there is of each rider


class Road:
    """The riders' world; see `Scene`.

    Attributes:
        course: The road.
        peloton: What riders want.
    """

    measure_names: tuple[str, ...] = ("progress", "offset", "shelter")

    def __init__(self, scenario: Scenario, device: str = "cpu", world: Mapping[str, Any] | None = None) -> None:
        """Lay the road.

        Args:
            scenario: What plays there.
            device: A Warp device.
            world: That of a recording to go on with, which holds its course; None loads the scenario's.

        Raises:
            InputError: There is no such course, or it has no room for riders or obstacles.
        """
        self.scenario = scenario
        self.course = Course.load(scenario.world.course) if world is None else Course.from_dict(world["course"])
        parked = [obstacle for obstacle in scenario.obstacles if obstacle.kind != "jogger"]
        self.peloton = Peloton(
            scenario.peloton,
            self.course.centreline,
            self.course.half_width,
            scenario.crowd.count,
            frame_rate=scenario.frame_rate,
            seed=scenario.seed,
            population_seed=scenario.population_seed,
            obstacles=scenario.obstacles,
            user=scenario.user,
            laps=scenario.world.laps or self.course.laps,
            device=device,
        )
        outlines = [obstacle_outline(obstacle, self.course.centreline) for obstacle in parked]
        walls = [np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1) for corners in outlines]
        self.terrain: Terrain = RoadTerrain.of(self.course.surfaces, device, np.concatenate([np.zeros((0, 4)), *walls]))
        self.world: Mapping[str, Any] = {
            "ground": {"shape": "road"},
            "course": self.course.to_dict(),
            "obstacles": [asdict(obstacle) for obstacle in scenario.obstacles],
            "walls": [],
        }
        self.actors: tuple[Actor, ...] = tuple(Actor(name, kind) for name, kind in self.peloton.actors)
        ridden = scenario.user is not None and scenario.user.by == "person"
        self.control_names: tuple[str, ...] = CONTROLS if ridden else ()
        self.beyond = int(scenario.user is not None)
        self.by_agent = frozenset(["down", *self.peloton.by_rider])
        self._down = np.zeros(scenario.crowd.count, dtype=bool)
        self._passed = self._counts()

    def divide(self, share: Share) -> None:
        self.peloton.share = share

    def load(self) -> None:
        self.peloton.load()

    def people(self, character: Character) -> tuple[Population, np.ndarray]:
        crowd, grid = self.scenario.crowd, self.peloton.grid
        count = crowd.count
        assert isinstance(character, Cyclist), "a scenario on a road has riders"
        people = character.population(
            count,
            self.scenario.population_seed,
            crowd.variation,
            crowd.in_phase,
            heading=grid.headings[:count],
            speed=grid.speeds[:count],
            grade=grid.grades[:count],
        )
        places = grid.positions[:count].copy()
        places[:, 2] = self.course.surfaces.height(places[:, :2])
        return people, places

    def prepare(self, engines: Sequence[Engine]) -> None:
        """Everything that they go by comes frame by frame."""

    def public(self) -> dict[str, wp.array]:
        riders = self.peloton.riders
        return {"lane": riders.lane, "target": riders.target, "command_speed": riders.command_speed}

    def step(self, frame: int, engine: Engine, between: Callable[[], None] | None = None) -> None:
        commands: Any = engine.command
        self.peloton.step(frame, engine.positions, engine.velocities, commands, engine.fallen, between)
        self._down = engine.fallen.numpy() != 0

    def ride(self, controls: np.ndarray) -> None:
        assert self.peloton.user is not None
        self.peloton.user.controls.assign(controls)

    def tallies(self) -> dict[str, wp.array]:
        a = self.peloton.referee.arrays
        return {
            "distance": a.distance,
            "off_road": a.off_road_count,
            "collisions": a.collisions,
            "struck": a.struck_count,
            "shelter": a.shelter_sum,
        }

    def keep_actors(self, slot: int, frames: SceneFrames) -> None:
        if self.actors:
            frames.actor_poses[slot] = self.peloton.actor_poses()

    def keep(self, frame: int, slot: int, frames: SceneFrames) -> None:
        referee, riders, share = self.peloton.referee.arrays, self.peloton.riders, self.peloton.share
        for place, column in enumerate((referee.progress, riders.offset, riders.shelter)):
            frames.measures[slot, :, place] = column.numpy()[share.first : share.first + share.count]
        if np.any(referee.totals.numpy() != self._passed["totals"]):
            self._note(frame, frames)
            self._passed = self._counts()

    def _note(self, frame: int, frames: SceneFrames) -> None:
        """What has begun in this frame; the user is no agent, and has no events of its own."""
        share, now = self.peloton.share, self._counts()
        for name in ("off_road", "struck", "finish"):
            for agent in np.flatnonzero(now[name] != self._passed[name]).tolist():
                if share.owns(agent):
                    frames.events.append((frame, 0, agent, EVENT_NAMES.index(name)))
        # The one of lower index tells of it, which the user, who has the last, never is.
        for agent, _ in self.peloton.referee.collisions():
            frames.events.append((frame, 0, agent, EVENT_NAMES.index("collision")))

    def _counts(self) -> dict[str, np.ndarray]:
        """What the referee has counted so far; copies."""
        arrays = self.peloton.referee.arrays
        counted = {
            "totals": arrays.totals,
            "off_road": arrays.off_road_count,
            "struck": arrays.struck_count,
            "finish": arrays.finish_frame,
        }
        return {name: array.numpy().copy() for name, array in counted.items()}

    def begin(self) -> None:
        self._passed = self._counts()

    @property
    def finished(self) -> bool:
        if self.scenario.until != "finished":
            return False
        out = self.peloton.referee.arrays.finish_frame.numpy() == UNFINISHED
        out[: len(self._down)] &= ~self._down
        return not out.any()

    def summary(self, last_frame: int, means: Mapping[str, np.ndarray]) -> dict[str, Any]:
        found: list[dict[str, Any]] = [*self.peloton.summary()]
        riders, user = found[: self.scenario.crowd.count], found[self.scenario.crowd.count :]
        for index, rider in enumerate(riders):
            rider["fallen"] = bool(self._down[index])
            rider |= {f"mean_{name}": float(values[index]) for name, values in means.items() if name in MEANS}
        up = [rider for rider in riders if not rider["fallen"]] or riders
        return {
            "in_corral": 0,
            "off_road": sum(rider["off_road"] for rider in riders),
            "struck": sum(rider["struck"] for rider in riders),
            "finished": sum(rider["finish_time"] is not None for rider in riders),
            "laps": min(rider["laps"] for rider in up),
            "distance_m": float(np.mean([rider["distance"] for rider in up])),
            "riders": riders,
            "user": user[0] if user else None,
        }

    def state(self) -> dict[str, np.ndarray]:
        count = self.scenario.crowd.count
        state: dict[str, np.ndarray] = {"down": self._down.copy()}
        for name, array in self.peloton.state().items():
            if name in self.by_agent:
                state[name] = array[:count]
                if self.beyond:
                    state[f"{name}{_OF_USER}"] = array[count:]
            else:
                state[name] = array
        return state

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        whole = {name: array for name, array in state.items() if not name.endswith(_OF_USER)}
        if self.beyond:
            for name in self.peloton.by_rider:
                whole[name] = np.concatenate([whole[name], state[f"{name}{_OF_USER}"]])
        self.peloton.load_state(whole)
        self._down = np.array(state["down"], dtype=bool)
